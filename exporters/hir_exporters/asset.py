"""The asset that exporters write: a mesh, its physical material and the environment light. numpy only.

Constructors accept lists and arrays of any real type and store contiguous float32 / int32 arrays. `validate_asset`
checks shapes and values.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from hir_exporters.asset_lamp import AssetLamp, lamp_description, validate_lamp
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.errors import InputError
from hir_exporters.metallic_parameters import (
    DEFAULT_DIELECTRIC_F0,
    MAX_DIELECTRIC_F0,
    base_color_of,
    effective_albedos,
)

BRDF_MODELS: Final = ("paper", "dielectric", "metallic")
"""BRDF models of a material; their formulas are in `hir_exporters.materials.brdf_numpy`."""

PAPER_SPECULAR_MAX: Final = 4 / np.pi
"""Largest specular albedo of the `paper` model: Zhu et al. divide the lobe by pi, this project divides it by 4."""

_UNIT_LENGTH_TOLERANCE = 1e-2
_METALLIC_TOLERANCE = 1e-5
"""Largest difference between the albedos of a `metallic` material and those of its parameters: rounding of float32."""
_VECTORS_PER_CHUNK = 1 << 16  # temporary arrays of a chunk fit into a processor's cache


@dataclass(frozen=True, eq=False)
class AssetMesh:
    """Triangles with one vertex for each pair of position and UV; counter-clockwise triangles face outwards."""

    positions: NDArray[np.float32]
    """(V, 3), world, +Y up."""
    normals: NDArray[np.float32]
    """(V, 3), unit."""
    uvs: NDArray[np.float32]
    """(V, 2), origin top-left as in glTF."""
    faces: NDArray[np.int32]
    """(F, 3) vertex indices."""
    tangents: NDArray[np.float32] | None = None
    """(V, 4) MikkTSpace tangent and sign of the bitangent. None: exporters compute them where a format needs them."""

    def __post_init__(self) -> None:
        _set(self, "positions", _array("mesh.positions", self.positions, np.float32))
        _set(self, "normals", _array("mesh.normals", self.normals, np.float32))
        _set(self, "uvs", _array("mesh.uvs", self.uvs, np.float32))
        _set(self, "faces", _indices("mesh.faces", self.faces))
        if self.tangents is not None:
            _set(self, "tangents", _array("mesh.tangents", self.tangents, np.float32))


@dataclass(frozen=True, eq=False)
class AssetMaterial:
    """BRDF parameters, all linear. Each is a texture (row 0 at v = 0, the top) or one value for the whole surface.

    `metallic` is made with `AssetMaterial.metallic` from glTF's parameters; its albedos are those of its two lobes.
    """

    model: Literal["paper", "dielectric", "metallic"]
    diffuse_albedo: NDArray[np.float32]
    """(H, W, 3) or (3,), 0..1."""
    specular_albedo: NDArray[np.float32]
    """(H, W, 3) or (3,): the lobe's factor in `paper` (0..4/pi), else the reflectance at normal incidence."""
    roughness: NDArray[np.float32]
    """(H, W) or (): GGX width alpha, ALPHA_MIN..1, not its square root."""
    normal: NDArray[np.float32] | None = None
    """(H, W, 3) unit vectors in tangent space, +Y up, or None."""
    observed: NDArray[np.bool_] | None = None
    """(H, W) True for texels that enough photographs observed; None where that is not known."""
    metalness: NDArray[np.float32] | None = None
    """(H, W) or (), 0..1: 1 for a metal. Only `metallic` has it."""
    dielectric_f0: float = DEFAULT_DIELECTRIC_F0
    """Reflectance at normal incidence where metalness is 0; only `metallic` uses it."""

    @classmethod
    def metallic(
        cls,
        base_color: ArrayLike,
        metalness: ArrayLike,
        roughness: ArrayLike,
        normal: ArrayLike | None = None,
        observed: ArrayLike | None = None,
        dielectric_f0: float = DEFAULT_DIELECTRIC_F0,
    ) -> AssetMaterial:
        """The `metallic` model: `diffuse_albedo` (1 - m) base, `specular_albedo` (1 - m) F0 + m base.

        glTF 2.0, appendix B.3.5. `base_color` is (H, W, 3) or (3,), `metalness` m (H, W) or (), both 0..1 and of one
        size; `roughness` is the GGX width alpha, as in the class. Raises `InputError` for textures of different size.
        """
        base = _array("material.base_color", base_color, np.float32)
        m = _array("material.metalness", metalness, np.float32)
        if base.ndim == 3 and m.ndim == 2 and base.shape[:2] != m.shape:
            raise InputError(
                f"material.base_color is {base.shape[1]} x {base.shape[0]} and material.metalness {m.shape[1]} x "
                f"{m.shape[0]} texels; resize one of them to the size of the other"
            )
        diffuse, specular = effective_albedos(base, m, dielectric_f0)
        # numpy arrays are made of the arguments in __post_init__
        return cls("metallic", diffuse, specular, roughness, normal, observed, m, dielectric_f0)  # type: ignore[arg-type]

    @property
    def base_color(self) -> NDArray[np.float32]:
        """(H, W, 3) or (3,), 0..1: glTF's base colour of a `metallic` material, rho_d + rho_s - (1 - m) F0."""
        if self.metalness is None:
            raise InputError(f"a material of the model {self.model!r} has no base colour; only 'metallic' has one")
        base = base_color_of(self.diffuse_albedo, self.specular_albedo, self.metalness, self.dielectric_f0)
        return np.clip(base, np.float32(0), np.float32(1), out=base)

    def __post_init__(self) -> None:
        for name in ("diffuse_albedo", "specular_albedo", "roughness", "normal", "metalness"):
            value = getattr(self, name)
            if value is not None:
                _set(self, name, _array(f"material.{name}", value, np.float32))
        if self.observed is not None:
            _set(self, "observed", _array("material.observed", self.observed, np.bool_))


@dataclass(frozen=True, eq=False)
class AssetEnvironment:
    """Distant light as a lat-long image (`hir_exporters.conventions`), and a lamp."""

    radiance: NDArray[np.float32]
    """(H, W, 3), linear, not negative."""
    to_world: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    """(3, 3) rotation from the map's axes to those of `frame`."""
    frame: Literal["world", "camera"] = "world"
    """`world`: the light is fixed in the world; `camera`: it moves with the camera."""
    lamp: AssetLamp | None = None
    """A lamp on the camera beside the distant light; None for none."""

    def __post_init__(self) -> None:
        _set(self, "radiance", _array("environment.radiance", self.radiance, np.float32))
        _set(self, "to_world", _array("environment.to_world", self.to_world, np.float64))


@dataclass(frozen=True, eq=False)
class Asset:
    """Everything that an exporter needs."""

    mesh: AssetMesh
    material: AssetMaterial
    environment: AssetEnvironment | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Where the asset comes from, as JSON values; written into the exported files."""
    name: str = "asset"

    @property
    def lamp(self) -> AssetLamp | None:
        """The lamp on the camera, if there is one."""
        return None if self.environment is None else self.environment.lamp


def validate_asset(asset: Asset) -> None:
    """Raises `InputError` for the first invalid field; the message names the field and what it must be."""
    if not isinstance(asset.environment, AssetEnvironment | None):
        raise InputError(f"environment is of the type {type(asset.environment).__name__}; give an AssetEnvironment")
    _validate_mesh(asset.mesh)
    _validate_material(asset.material)
    if asset.environment is not None:
        _validate_environment(asset.environment)
    if not isinstance(asset.name, str) or not asset.name.strip() or len(asset.name) > 200:
        raise InputError("name is not a string of 1 to 200 characters")
    try:
        json.dumps(dict(asset.provenance), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"provenance cannot be written as JSON ({error}); use strings, finite numbers, lists and dictionaries"
        ) from error


def textures(material: AssetMaterial) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Name and pixels of each parameter that is a texture."""
    for name in ("diffuse_albedo", "specular_albedo", "roughness", "normal", "metalness"):
        value = getattr(material, name)
        if value is not None and value.ndim >= 2:
            yield name, value


def describe(asset: Asset) -> dict[str, Any]:
    """Summary as JSON values: counts, bounds, constants, sizes of textures and of the environment."""
    mesh, material, environment = asset.mesh, asset.material, asset.environment
    sizes = {name: f"{value.shape[1]} x {value.shape[0]}" for name, value in textures(material)}
    parameters = {}
    for name in ("diffuse_albedo", "specular_albedo", "roughness", "normal"):
        value = getattr(material, name)
        parameters[name] = None if value is None else sizes.get(name, value.tolist())
    if material.metalness is not None:
        parameters["metalness"] = sizes.get("metalness", material.metalness.tolist())
        parameters["dielectric_f0"] = material.dielectric_f0
    return {
        "name": asset.name,
        "vertices": len(mesh.positions),
        "triangles": len(mesh.faces),
        "bounds": [mesh.positions.min(axis=0).tolist(), mesh.positions.max(axis=0).tolist()],
        "model": material.model,
        **parameters,
        "observed": None if material.observed is None else round(float(material.observed.mean()), 4),
        "environment": None
        if environment is None
        else {
            "size": f"{environment.radiance.shape[1]} x {environment.radiance.shape[0]}",
            "frame": environment.frame,
            "mean_radiance": environment.radiance.mean(axis=(0, 1), dtype=np.float64).tolist(),
            **({} if environment.lamp is None else {"lamp": lamp_description(environment.lamp)}),
        },
    }


def _validate_mesh(mesh: AssetMesh) -> None:
    count = len(mesh.positions)
    if mesh.positions.size == 0 or mesh.faces.size == 0:
        raise InputError("mesh.faces contains no triangles; an asset needs at least one")
    _check_shape("mesh.positions", mesh.positions, (None, 3))
    _check_shape("mesh.faces", mesh.faces, (None, 3))
    _check_shape("mesh.normals", mesh.normals, (count, 3))
    _check_shape("mesh.uvs", mesh.uvs, (count, 2))
    for name in ("positions", "normals", "uvs"):
        _check_finite(f"mesh.{name}", getattr(mesh, name))
    low, high = int(mesh.faces.min()), int(mesh.faces.max())
    if low < 0 or high >= count:
        raise InputError(f"mesh.faces has the index {low if low < 0 else high}, but the mesh has {count} vertices")
    _check_unit("mesh.normals", mesh.normals)
    if mesh.tangents is not None:
        _check_shape("mesh.tangents", mesh.tangents, (count, 4))
        _check_finite("mesh.tangents", mesh.tangents)
        _check_unit("mesh.tangents", mesh.tangents[:, :3])
        if not (np.abs(mesh.tangents[:, 3]) == 1).all():
            raise InputError("mesh.tangents has a fourth component that is neither 1 nor -1")


def _validate_material(material: AssetMaterial) -> None:
    if material.model not in BRDF_MODELS:
        raise InputError(f"material.model is {material.model!r}; known are {', '.join(BRDF_MODELS)}")
    specular_limit = PAPER_SPECULAR_MAX if material.model == "paper" else 1.0
    for name, limit in (("diffuse_albedo", 1.0), ("specular_albedo", specular_limit)):
        value = getattr(material, name)
        if value.shape != (3,):
            _check_shape(f"material.{name}", value, (None, None, 3), "(H, W, 3) or (3,)")
        _check_range(f"material.{name}", value, 0.0, limit)
    if material.roughness.ndim != 0:
        _check_shape("material.roughness", material.roughness, (None, None), "(H, W) or one number")
    _check_range("material.roughness", material.roughness, ALPHA_MIN, 1.0)
    if material.normal is not None:
        _check_shape("material.normal", material.normal, (None, None, 3))
        _check_finite("material.normal", material.normal)
        _check_unit("material.normal", material.normal.reshape(-1, 3))
    if material.observed is not None:
        _check_shape("material.observed", material.observed, (None, None))
    _validate_metalness(material)


def _validate_metalness(material: AssetMaterial) -> None:
    if material.model != "metallic":
        if material.metalness is not None or material.dielectric_f0 != DEFAULT_DIELECTRIC_F0:
            field_name = "metalness" if material.metalness is not None else "dielectric_f0"
            raise InputError(
                f"material.{field_name} is set, but the model is {material.model!r}; only 'metallic' has it: use "
                "AssetMaterial.metallic, or leave it out"
            )
        return
    if material.metalness is None:
        raise InputError("material.metalness is missing; the model 'metallic' needs it: use AssetMaterial.metallic")
    if material.metalness.ndim != 0:
        _check_shape("material.metalness", material.metalness, (None, None), "(H, W) or one number")
    _check_range("material.metalness", material.metalness, 0.0, 1.0)
    f0 = material.dielectric_f0
    if not isinstance(f0, int | float) or not 0 <= f0 <= MAX_DIELECTRIC_F0:
        raise InputError(f"material.dielectric_f0 is {f0!r}; it must be one number from 0 to {MAX_DIELECTRIC_F0}")
    values = (material.diffuse_albedo, material.specular_albedo, material.metalness[..., None])
    sizes = {value.shape[:2] for value in values if value.ndim == 3}
    if len(sizes) > 1:
        found = " and ".join(f"{width} x {height}" for height, width in sorted(sizes))
        raise InputError(f"material has albedos and a metalness of {found} texels; resize them to one size")
    off, low, high = _metallic_ranges(material)
    if off > _METALLIC_TOLERANCE:
        raise InputError(
            f"material.diffuse_albedo and specular_albedo differ by {off:.2g} from those of metalness and "
            "dielectric_f0; make the material with AssetMaterial.metallic(base_color, metalness, roughness)"
        )
    if max(-low, high - 1) > _METALLIC_TOLERANCE:
        raise InputError(f"material.base_color ranges from {low:.6g} to {high:.6g}; it must be from 0 to 1")


def _metallic_ranges(material: AssetMaterial) -> tuple[float, float, float]:
    """Largest difference of the diffuse albedo from that of the base colour, the colour's minimum and its maximum."""
    assert material.metalness is not None
    metalness = material.metalness[..., None]
    values = (material.diffuse_albedo, material.specular_albedo, metalness)
    height, width = max(value.shape[:2] if value.ndim == 3 else (1, 1) for value in values)
    rows = max(1, _VECTORS_PER_CHUNK // width)
    off, low, high = [], [], []
    for start in range(0, height, rows):
        diffuse, specular, m = (v[start : start + rows] if v.ndim == 3 else v for v in values)
        raw = base_color_of(diffuse, specular, m[..., 0], material.dielectric_f0)
        off.append(np.abs((np.float32(1) - m) * raw - diffuse).max())
        low.append(raw.min())
        high.append(raw.max())
    return float(max(off)), float(min(low)), float(max(high))


def _validate_environment(environment: AssetEnvironment) -> None:
    _check_shape("environment.radiance", environment.radiance, (None, None, 3))
    _check_finite("environment.radiance", environment.radiance)
    if environment.radiance.min() < 0:
        raise InputError("environment.radiance has negative values; clip them to 0")
    _check_shape("environment.to_world", environment.to_world, (3, 3))
    _check_finite("environment.to_world", environment.to_world)
    off = np.abs(environment.to_world @ environment.to_world.T - np.eye(3)).max()
    if off > 1e-4 or np.linalg.det(environment.to_world) < 0:
        raise InputError("environment.to_world is not a rotation: rows must be orthonormal and the determinant 1")
    if environment.frame not in ("world", "camera"):
        raise InputError(f"environment.frame is {environment.frame!r}; it is 'world' or 'camera'")
    if environment.lamp is not None:
        validate_lamp(environment.lamp)


def _check_shape(name: str, value: NDArray[Any], shape: tuple[int | None, ...], expected: str = "") -> None:
    fits = value.ndim == len(shape) and all(
        size is None or actual == size for actual, size in zip(value.shape, shape, strict=False)
    )
    if not fits:
        names = expected or "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise InputError(f"{name} has the shape {value.shape}; it must be {names}")
    if value.size == 0:
        raise InputError(f"{name} is empty")


def _check_finite(name: str, value: NDArray[Any]) -> None:
    if value.size and np.isfinite(_extremes(value)).all():
        return
    bad = value.size - int(np.isfinite(value).sum())
    if bad:
        raise InputError(f"{name} contains {bad} NaN or infinite values; remove or replace them")


def _check_range(name: str, value: NDArray[Any], low: float, high: float) -> None:
    least, most = _extremes(value)
    if not (np.isfinite(least) and np.isfinite(most)):
        _check_finite(name, value)
    slack = 1e-6  # allows for the float32 rounding of a value at the limit
    if least < low * (1 - slack) - slack * (low == 0) or most > high * (1 + slack):
        raise InputError(f"{name} ranges from {least:.6g} to {most:.6g}; it must be from {low:.4g} to {high:.4g}")


def _extremes(value: NDArray[Any]) -> tuple[Any, Any]:
    """Smallest and largest value of a contiguous array, NaN where one is NaN; each part is read once from memory."""
    parts = value.reshape(-1)
    chunks = (parts[first : first + _VECTORS_PER_CHUNK] for first in range(0, len(parts), _VECTORS_PER_CHUNK))
    both = [(chunk.min(), chunk.max()) for chunk in chunks]
    least, most = np.array(both, value.dtype).T
    return least.min(), most.max()


def _check_unit(name: str, vectors: NDArray[np.float32]) -> None:
    bad = 0
    for first in range(0, len(vectors), _VECTORS_PER_CHUNK):
        part = vectors[first : first + _VECTORS_PER_CHUNK]
        squared = np.einsum("ij,ij->i", part, part)  # float32 is precise enough for a tolerance of 1 %
        bad += int((np.abs(np.sqrt(squared, out=squared) - 1) > _UNIT_LENGTH_TOLERANCE).sum())
    if bad:
        raise InputError(f"{name} has {bad} vectors that are not of length 1; normalise them")


def _contiguous(value: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    # A view into a file's records may be contiguous without being aligned, which USD's arrays refuse.
    return np.require(np.asarray(value), dtype, ["C", "A"])


def _array(name: str, value: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    try:
        with np.errstate(over="ignore"):  # a float64 beyond float32 becomes infinite, which validate_asset reports
            return _contiguous(value, dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not an array of numbers ({error})") from error


def _indices(name: str, value: ArrayLike) -> NDArray[np.int32]:
    array = np.asarray(value)
    if array.size == 0:
        return np.zeros((0, 3), dtype=np.int32) if array.ndim != 2 else array.astype(np.int32)
    if not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{name} has the type {array.dtype}; vertex indices are integers")
    if int(array.max()) > np.iinfo(np.int32).max or int(array.min()) < np.iinfo(np.int32).min:
        raise InputError(f"{name} has an index that does not fit into 32 bits")
    return _contiguous(array, np.int32)


def _set(instance: object, name: str, value: object) -> None:
    object.__setattr__(instance, name, value)  # a frozen dataclass cannot be assigned to in another way
