"""Decodes a file that was read back into an asset: its mesh, and its material in the closest BRDF model.

The file is read by libraries that share no code with the exporters (`gltf_readback`, `usd_readback`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import PAPER_SPECULAR_MAX, AssetMaterial, AssetMesh
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials.material_conversion import NO_FRESNEL_IOR
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.materials.target_brdfs import ior_to_f0
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0, MAX_DIELECTRIC_F0
from hir_exporters.reading.readback import ReadBack
from hir_exporters.textures.texture_maps import common_size, resize

Array = NDArray[np.floating]

CORE_IOR = 1.5


@dataclass(frozen=True, eq=False)
class DecodedAsset:
    """Mesh and material of a file, and how its material was interpreted."""

    mesh: AssetMesh
    material: AssetMaterial
    interpretation: str
    """One phrase: the conversion from the file's parameters to the model."""


def decode_asset(back: ReadBack, profile: str = "khr", as_metallic: bool = True) -> DecodedAsset:
    """The asset of a file that was read back. Files of the profile `blender` are interpreted as Blender does."""
    material, interpretation = decode_material(back, profile, as_metallic)
    return DecodedAsset(unindexed_mesh(back), material, interpretation)


def decode_material(back: ReadBack, profile: str, as_metallic: bool = True) -> tuple[AssetMaterial, str]:
    """Parameters of the BRDF model that is closest to the format's own formula, texel by texel.

    An ior of 1000 encodes a lobe without Fresnel: the `paper` model, exact for grey lobes. Metallic-roughness that is
    metal somewhere and has no specular weight or colour becomes `metallic` with the file's own values. All other
    materials become `dielectric` with the same F0, lobe and diffuse reflection at normal incidence. At grazing angles
    the diffuse part decreases as in `dielectric`, not as in the format.

    Without `as_metallic` no material becomes `metallic`. This is closer to the format's formula where a file has
    metalness between 0 and 1 from a fit to another model: `metallic` couples its diffuse part to the mixed lobe.
    """
    return decode_surface(back.surface, back.specular_surface, back.normal, profile, as_metallic)


def decode_surface(
    surface: MetallicSurface,
    specular_surface: SpecularSurface | None,
    normal: NDArray[np.float32] | None,
    profile: str = "khr",
    as_metallic: bool = True,
) -> tuple[AssetMaterial, str]:
    """`decode_material` of a material without its mesh."""
    if specular_surface is not None:
        return _specular_workflow(specular_surface, normal), "specular workflow as `dielectric` of the same F0"
    if surface.ior >= NO_FRESNEL_IOR and not np.any(surface.metallic):
        return _without_fresnel(surface, normal, profile), "no Fresnel (ior 1000) as `paper`"
    f0 = float(ior_to_f0(surface.ior))
    plain = np.all(surface.specular_weight == 1) and np.all(surface.specular_color == 1)
    if as_metallic and plain and np.any(surface.metallic) and f0 <= MAX_DIELECTRIC_F0:
        return _metal(surface, normal, f0), f"metallic-roughness as `metallic`, F0 of ior {surface.ior:.4g}"
    phrase = "metallic-roughness as `dielectric` with rho_d = base (1 - metal), rho_s = F0 (1 - metal) + base metal"
    return _metallic(surface, normal), f"{phrase}, F0 of ior {surface.ior:.4g}"


def _metal(surface: MetallicSurface, normal: NDArray[np.float32] | None, f0: float) -> AssetMaterial:
    base, m = _at_common_size((surface.base_color, 1), (surface.metallic, 0))
    return AssetMaterial.metallic(
        np.clip(base, 0, 1),
        np.clip(m, 0, 1),
        _alpha(surface.roughness),
        _unit_vectors(normal),
        dielectric_f0=DEFAULT_DIELECTRIC_F0 if surface.ior == CORE_IOR else f0,
    )


def _metallic(surface: MetallicSurface, normal: NDArray[np.float32] | None) -> AssetMaterial:
    base, m, weight, color = _at_common_size(
        (surface.base_color, 1), (surface.metallic, 0), (surface.specular_weight, 0), (surface.specular_color, 1)
    )
    m, weight = m[..., None], weight[..., None]
    f0 = weight * np.minimum(ior_to_f0(surface.ior) * color, 1)
    specular = np.clip(f0 * (1 - m) + base * m, 0, 1)
    # Diffuse reflection at normal incidence: (1 - m)(1 - max F0) base in glTF, (1 - rho_s) rho_d in `dielectric`.
    reflected = (1 - m) * (1 - f0.max(axis=-1, keepdims=True)) * base
    return _material("dielectric", _diffuse_albedo(reflected, specular), specular, surface.roughness, normal)


def _specular_workflow(surface: SpecularSurface, normal: NDArray[np.float32] | None) -> AssetMaterial:
    diffuse, specular = _at_common_size((surface.diffuse, 1), (surface.specular, 1))
    reflected = (1 - specular.max(axis=-1, keepdims=True)) * diffuse
    return _material("dielectric", _diffuse_albedo(reflected, specular), specular, surface.roughness, normal)


def _without_fresnel(surface: MetallicSurface, normal: NDArray[np.float32] | None, profile: str) -> AssetMaterial:
    base, weight, color = _at_common_size(
        (surface.base_color, 1), (surface.specular_weight, 0), (surface.specular_color, 1)
    )
    # At this ior Blender was measured to reflect the tint itself; the ratified extension multiplies by F0 = 0.996.
    factor = 1.0 if profile == "blender" else ior_to_f0(surface.ior)
    specular = np.minimum(factor * color, 1) * weight[..., None]
    diffuse = (1 - specular.max(axis=-1, keepdims=True)) * base
    return _material("paper", diffuse, specular, surface.roughness, normal)


def _diffuse_albedo(reflected: Array, specular: Array) -> Array:
    """rho_d of `dielectric` with this diffuse reflection at normal incidence; 0 where rho_s is 1."""
    return np.where(specular < 1, reflected / np.maximum(1 - specular, 1e-6), 0.0)


def _material(
    model: str, diffuse: Array, specular: Array, roughness: Array, normal: NDArray[np.float32] | None
) -> AssetMaterial:
    limit = PAPER_SPECULAR_MAX if model == "paper" else 1.0
    return AssetMaterial(
        model="paper" if model == "paper" else "dielectric",
        diffuse_albedo=np.clip(diffuse, 0, 1).astype(np.float32),
        specular_albedo=np.clip(specular, 0, limit).astype(np.float32),
        roughness=_alpha(roughness),
        normal=_unit_vectors(normal),
    )


def _alpha(roughness: Array) -> NDArray[np.float32]:
    return np.asarray(np.clip(np.square(roughness), ALPHA_MIN, 1), np.float32)


def _unit_vectors(normal: NDArray[np.float32] | None) -> NDArray[np.float32] | None:
    """A normal map whose 8-bit codes have lengths that differ slightly from 1, normalised."""
    return None if normal is None else normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)


def _at_common_size(*values: tuple[Array, int]) -> list[Array]:
    """Constants, and textures resized to one size; each value comes with its number of channel axes."""
    size = common_size(*(v for v, _ in values), channels=tuple(c for _, c in values))
    return [resize(v, *size) if size and v.ndim - c == 2 else v for v, c in values]


def unindexed_mesh(back: ReadBack) -> AssetMesh:
    """One vertex for each corner; shared vertices are not restored."""
    count = 3 * len(back.corner_positions)
    return AssetMesh(
        positions=back.corner_positions.reshape(count, 3).astype(np.float32),
        normals=back.corner_normals.reshape(count, 3).astype(np.float32),
        uvs=back.corner_uvs.reshape(count, 2).astype(np.float32),
        faces=np.arange(count, dtype=np.int32).reshape(-1, 3),
    )
