"""An asset from files that no run of ours made: a mesh with UVs, textures as engines have them, a light.

Meshes are .obj, .ply, .glb, .gltf and USD. A .glb, .gltf or .usd brings its material, an .obj the one of its .mtl (with
the PBR statements Pr, Pm, norm); what is given by hand takes its place. Nothing outside a file's own folder is opened
unless the caller names it.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh, validate_asset
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import HirError, InputError
from hir_exporters.materials.material_conversion import collapse_uniform_textures
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.reading.asset_decoding import decode_asset, decode_surface
from hir_exporters.reading.readback import gltf_scene, read_gltf_surface
from hir_exporters.reading.usd_import import read_untrusted_usd
from hir_exporters.textures.image_files import read_exr, read_hdr, read_ldr

Array = NDArray[np.floating]

MESH_SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".usda", ".usdc", ".usdz", ".usd")


@dataclass(frozen=True)
class MaterialOverrides:
    """A metallic-roughness material as files or numbers; None takes what the mesh's file says, else the default."""

    base_color: Path | tuple[float, float, float] | None = None
    """sRGB image (linear where it is .exr or .hdr), or linear RGB; grey 0.5 by default."""
    roughness: Path | float | None = None
    """Perceptual roughness, the square root of GGX's width; 0.5 by default."""
    metallic: Path | float | None = None
    """0 by default."""
    normal: Path | None = None
    """Tangent space normals, green up."""


def load_mesh_asset(path: Path, maps: MaterialOverrides | None = None, light: Path | None = None) -> Asset:
    """The mesh of a file with its material, or with `maps`, as a `dielectric`; `light` is a lat-long .hdr or .exr.

    Raises `InputError` naming the file, the field and how to mend it.
    """
    path, maps = Path(path), maps or MaterialOverrides()
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"{path} is no mesh that can be read; known are {', '.join(MESH_SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path} is not there")
    if suffix.startswith(".usd"):
        written = decode_asset(read_untrusted_usd(path))
        mesh, material = written.mesh, written.material
        if maps != MaterialOverrides():
            raise InputError(f"{path} brings its own material; textures can be given with .obj, .ply, .glb and .gltf")
    else:
        mesh = _trimesh_mesh(path)
        material = _material(path, suffix, maps)
    material = collapse_uniform_textures(material)
    asset = Asset(
        mesh, material, None if light is None else read_environment(light), {"made_from": path.name}, path.stem
    )
    try:
        validate_asset(asset)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return asset


def read_environment(path: Path) -> AssetEnvironment:
    """A lat-long .hdr or .exr, +Z in its middle, in the asset's axes."""
    if path.suffix.lower() not in (".hdr", ".exr"):
        raise InputError(f"{path}: a light is a lat-long .hdr or .exr")
    radiance = read_exr(path, channels=3) if path.suffix.lower() == ".exr" else read_hdr(path)
    return AssetEnvironment(np.maximum(radiance, 0))


def _trimesh_mesh(path: Path) -> AssetMesh:
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of numbers that are refused below, in words
            if path.suffix.lower() in (".glb", ".gltf"):
                from pygltflib import GLTF2

                loaded = gltf_scene(path, GLTF2().load(str(path)))
            else:
                loaded = trimesh.load_scene(path, process=False, maintain_order=True)
            parts: list[Any] = [m for m in loaded.dump() if isinstance(m, trimesh.Trimesh) and len(m.faces)]
    except HirError:
        raise
    except IndexError as error:
        raise InputError(f"{path}: mesh.faces, or what describes it, has an index out of range ({error})") from error
    except Exception as error:  # a library with many ways to fail on a broken file
        raise InputError(f"{path} cannot be read as a mesh ({type(error).__name__}: {error})") from error
    if not parts:
        raise InputError(f"{path}: mesh.faces holds no triangles")
    for part in parts:
        positions, faces = np.asarray(part.vertices), np.asarray(part.faces)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise InputError(f"{path}: mesh.positions are not three numbers a vertex")
        if faces.min() < 0 or faces.max() >= len(positions):
            raise InputError(f"{path}: mesh.faces has an index out of range (it has {len(positions)} vertices)")
        uvs = getattr(part.visual, "uv", None)
        if uvs is None or len(uvs) != len(part.vertices):
            raise InputError(f"{path}: mesh.uvs is missing: it has no texture coordinates; unwrap the mesh first")
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return AssetMesh(
        positions=np.concatenate([part.vertices for part in parts]),
        normals=np.concatenate([_unit_normals(part) for part in parts]),
        uvs=np.concatenate([np.asarray(part.visual.uv) for part in parts]) * [1, -1] + [0, 1],  # v is upwards there
        faces=np.concatenate([np.asarray(p.faces) + offset for p, offset in zip(parts, offsets, strict=True)]),
    )


def _unit_normals(part: Any) -> Array:
    """Vertex normals as the file has them, else area-weighted; up where a vertex belongs to no area."""
    normals = np.array(part.vertex_normals, np.float64)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])


def _material(path: Path, suffix: str, maps: MaterialOverrides) -> AssetMaterial:
    surface, normal = _plain_surface(), None
    if suffix in (".glb", ".gltf") and _unset(maps):
        material, _ = decode_surface(*read_gltf_surface(path))
        return material if maps.normal is None else replace(material, normal=_normal(maps.normal))
    if suffix in (".glb", ".gltf"):
        surface, _, normal = read_gltf_surface(path)
    elif suffix == ".obj":
        maps = _filled(maps, _mtl_maps(path))
    surface = replace(
        surface,
        base_color=surface.base_color if maps.base_color is None else _color(maps.base_color),
        roughness=surface.roughness if maps.roughness is None else _scalar(maps.roughness, "roughness"),
        metallic=surface.metallic if maps.metallic is None else _scalar(maps.metallic, "metallic"),
    )
    material, _ = decode_surface(surface, None, normal if maps.normal is None else _normal(maps.normal))
    return material


def _plain_surface() -> MetallicSurface:
    one = np.ones((), np.float32)
    return MetallicSurface(
        base_color=np.full(3, 0.5, np.float32),
        metallic=0 * one,
        roughness=0.5 * one,
        specular_weight=one,
        specular_color=np.ones(3, np.float32),
        ior=1.5,
        residual=0.0,
    )


def _unset(maps: MaterialOverrides) -> bool:
    return maps.base_color is None and maps.roughness is None and maps.metallic is None


def _filled(maps: MaterialOverrides, found: MaterialOverrides) -> MaterialOverrides:
    """What was given, else what was found."""

    def either(name: str) -> Any:
        given = getattr(maps, name)
        return getattr(found, name) if given is None else given

    return MaterialOverrides(either("base_color"), either("roughness"), either("metallic"), either("normal"))


def _mtl_maps(path: Path) -> MaterialOverrides:
    """What the first material of an .obj's .mtl says; empty where there is none."""
    library = next((name for key, name in _statements(path, limit=2000) if key == "mtllib"), None)
    file = None if library is None else _beside(path, library)
    if file is None or not os.path.isfile(file):  # pathlib's raises where a name is too long
        return MaterialOverrides()
    said: dict[str, str] = {}
    for key, value in _statements(file):
        if key == "newmtl" and "newmtl" in said:
            break
        said[key] = value

    def image(key: str) -> Path | None:
        # options such as -bm 1.0 stand before the name
        return _beside(path, said[key].split()[-1]) if key in said else None

    def number(key: str) -> float | None:
        return _number(said[key], f"{file}: {key}") if key in said else None

    color = tuple(_number(x, f"{file}: Kd") for x in said["Kd"].split()[:3]) if "Kd" in said else None
    if color is not None and len(color) != 3:
        raise InputError(f"{file}: Kd is not three numbers")
    return MaterialOverrides(
        base_color=image("map_Kd") or color,  # type: ignore[arg-type] # three numbers, as was just checked
        roughness=image("map_Pr") or number("Pr"),
        metallic=image("map_Pm") or number("Pm"),
        normal=image("norm"),
    )


def _statements(path: Path, limit: int = 1 << 30) -> list[tuple[str, str]]:
    """Keyword and rest of each line that has both, of the first `limit` lines."""
    found = []
    with open(path, encoding="utf-8", errors="replace") as lines:
        for count, line in enumerate(lines):
            key, _, rest = line.strip().partition(" ")
            if rest and not key.startswith("#"):
                found.append((key, rest.strip()))
            if count >= limit:
                break
    return found


def _beside(path: Path, name: str) -> Path:
    """A file that another names, which must lie in the other's folder."""
    try:
        file = (path.parent / name.replace("\\", "/")).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a name with a null in it, links that go round
        raise InputError(f"{path} names {name[:80]!r}, which is no file ({error})") from error
    if not file.is_relative_to(path.parent.resolve()):
        raise InputError(f"{path} names {name!r}, which lies outside of its folder; put the file beside it")
    return file


def _number(text: str, where: str) -> float:
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        raise InputError(f"{where} is {text!r}, not a number") from None


def _pixels(path: Path) -> tuple[Array, bool]:
    """Pixels (H, W, C) and whether they are linear already."""
    if path.suffix.lower() in (".exr", ".hdr"):
        return read_hdr(path), True
    return read_ldr(path), False


def _color(value: Path | tuple[float, float, float]) -> Array:
    if not isinstance(value, Path):
        return _within(value, "base_color")
    pixels, linear = _pixels(value)
    pixels = pixels if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    return pixels[..., :3] if linear else srgb_to_linear(pixels[..., :3])


def _scalar(value: Path | float, name: str) -> Array:
    if not isinstance(value, Path):
        return _within(value, name)
    pixels, _ = _pixels(value)
    # of a packed image (occlusion, roughness, metalness) the channel that glTF keeps it in
    channel = {"roughness": 1, "metallic": 2}[name] if pixels.shape[2] >= 3 else 0
    return np.ascontiguousarray(pixels[..., channel])


def _within(value: float | tuple[float, float, float], name: str) -> Array:
    numbers = np.asarray(value, np.float32)
    if not (np.isfinite(numbers).all() and numbers.min() >= 0 and numbers.max() <= 1):
        raise InputError(f"{name} is {value}; it must be from 0 to 1")
    return numbers


def _normal(path: Path) -> NDArray[np.float32]:
    pixels, linear = _pixels(path)
    if pixels.shape[2] < 3:
        raise InputError(f"{path} is grey; a normal map has three channels")
    vectors = np.asarray(pixels[..., :3] if linear else pixels[..., :3] * 2 - 1, np.float32)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-3, vectors / np.maximum(length, 1e-3), np.array([0, 0, 1], np.float32))


PARSED: Final[Mapping[str, str]] = {"base_color": "R,G,B", "roughness": "NUMBER", "metallic": "NUMBER"}
"""What may be given in place of a file, by the name of a map."""


def parse_material_override(name: str, text: str) -> Any:
    """A file, or the number or colour that stands in its place. Raises `InputError` naming the option."""
    if name != "normal":
        parts = text.split(",")
        try:
            numbers = tuple(float(part) for part in parts)
        except ValueError:
            numbers = ()
        if numbers and len(numbers) == (3 if name == "base_color" else 1):
            return numbers if name == "base_color" else numbers[0]
    file = Path(text)
    if not file.is_file():
        wanted = f" or {PARSED[name]}" if name in PARSED else ""
        raise InputError(f"{text} for {name.replace('_', ' ')} is not there; give an image file{wanted}")
    return file
