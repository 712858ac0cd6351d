"""The error of a material conversion: the relative difference between the asset's BRDF and the target's formula.

It is measured on `hir_exporters.materials.brdf_slice` with the published formula of the target
(`hir_exporters.materials.target_brdfs`) and the converted values, at up to 144 texels.

A `metallic` material has the parameters of the metallic-roughness formats. Against these its BRDF is the target's own
formula with the asset's parameters, so that the error is that of the parameters alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMaterial
from hir_exporters.materials import brdf_slice, target_brdfs
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.metallic_parameters import base_color_of
from hir_exporters.textures.texture_maps import sample_texels

Array = NDArray[np.floating]


def metallic_residual(
    material: AssetMaterial,
    surface: MetallicSurface,
    as_blender: bool = False,
    expected: MetallicSurface | None = None,
) -> float:
    """Relative error on the BRDF slice of a surface, by glTF's ratified formula or as Blender reads ior 1000.

    The reference is the material's model, or glTF's formula with the parameters `expected`.
    """
    uvs, directions, reference = _reference_samples(material)
    if expected is not None:
        reference = _gltf_values(expected, uvs, directions)
    elif material.metalness is not None:
        reference = target_brdfs.gltf_brdf(
            directions,
            *_sampled_metallic(material, material.metalness, uvs),
            np.ones(len(uvs)),
            np.ones((len(uvs), 3)),
            target_brdfs.f0_to_ior(material.dielectric_f0),
        )
    if as_blender:
        base, color = (sample_texels(value, True, uvs) for value in (surface.base_color, surface.specular_color))
        converted = target_brdfs.blender_brdf(directions, base, color)
    else:
        converted = _gltf_values(surface, uvs, directions)
    return brdf_slice.relative_error(directions, converted, reference)


def _sampled_metallic(
    material: AssetMaterial, metalness: Array, uvs: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Base colour (T, 3) and metalness (T,) at texels; the colour of the other texels is not computed."""
    diffuse, specular = (
        sample_texels(value, True, uvs).astype(np.float32)
        for value in (material.diffuse_albedo, material.specular_albedo)
    )
    m = sample_texels(metalness, False, uvs)
    base = base_color_of(diffuse, specular, m.astype(np.float32), material.dielectric_f0)
    return np.clip(base, 0, 1).astype(np.float64), m


def _gltf_values(
    surface: MetallicSurface, uvs: NDArray[np.float64], directions: brdf_slice.BrdfSlice
) -> NDArray[np.float64]:
    base, color = (sample_texels(value, True, uvs) for value in (surface.base_color, surface.specular_color))
    metallic, weight = (sample_texels(value, False, uvs) for value in (surface.metallic, surface.specular_weight))
    return target_brdfs.gltf_brdf(directions, base, metallic, weight, color, surface.ior)


def specular_residual(material: AssetMaterial, surface: SpecularSurface) -> float:
    """Relative error on the BRDF slice of a surface in the specular workflow."""
    uvs, directions, reference = _reference_samples(material)
    diffuse, specular = (sample_texels(value, True, uvs) for value in (surface.diffuse, surface.specular))
    return brdf_slice.relative_error(
        directions, target_brdfs.specular_workflow_brdf(directions, diffuse, specular), reference
    )


def _reference_samples(
    material: AssetMaterial,
) -> tuple[NDArray[np.float64], brdf_slice.BrdfSlice, NDArray[np.float64]]:
    """UVs of the sampled texels, their BRDF slices and the model's values on them."""
    uvs = sample_uvs(material)
    directions = brdf_slice.brdf_slice(sample_texels(material.roughness, False, uvs))
    diffuse = sample_texels(material.diffuse_albedo, True, uvs)
    specular = sample_texels(material.specular_albedo, True, uvs)
    return uvs, directions, brdf_slice.model_brdf(directions, material.model, diffuse, specular)


def sample_uvs(material: AssetMaterial) -> NDArray[np.float64]:
    """UVs (T, 2) of the texels on which residuals are measured: 12 x 12, or one for a constant material."""
    side = 12 if any(v.ndim > c for v, c in material_parameters(material)) else 1
    y, x = np.mgrid[:side, :side]
    return np.asarray((np.stack([x.ravel(), y.ravel()], axis=-1) + 0.5) / side)


def material_parameters(material: AssetMaterial) -> list[tuple[Array, int]]:
    """Diffuse albedo, specular albedo and alpha, each with its number of channel axes."""
    return [(material.diffuse_albedo, 1), (material.specular_albedo, 1), (material.roughness, 0)]
