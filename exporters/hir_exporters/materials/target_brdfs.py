"""The published BRDF of each target format, evaluated on a BRDF slice.

Conversions measure their error with these formulas. Albedos are (T, 3), scalars (T,); results are f (T, 7, 68, 3) for
the directions of `hir_exporters.materials.brdf_slice`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_exporters.materials.brdf_slice import BrdfSlice

Array = NDArray[np.float64]

CORE_F0 = 0.04
"""Reflectance at normal incidence of every non-metal of core glTF and of UsdPreviewSurface's default ior 1.5."""


def ior_to_f0(ior: float) -> float:
    """Reflectance at normal incidence for an index of refraction against air."""
    return ((ior - 1) / (ior + 1)) ** 2


def f0_to_ior(f0: float) -> float:
    """Index of refraction above 1 with that reflectance at normal incidence, f0 in [0, 1)."""
    root = np.sqrt(f0)
    return float((1 + root) / (1 - root))


def gltf_brdf(
    slices: BrdfSlice,
    base_color: Array,
    metallic: Array,
    specular_weight: Array,
    specular_color: Array,
    ior: float,
) -> Array:
    """glTF 2.0 appendix B with KHR_materials_specular and KHR_materials_ior as ratified.

    With weight 1, colour 1 and ior 1.5 it is core glTF.
    """
    base = base_color[:, None, None, :]
    m, weight = metallic[:, None, None, None], specular_weight[:, None, None, None]
    s, lobe = slices.schlick[..., None], slices.lobe[..., None]
    f0 = np.minimum(ior_to_f0(ior) * specular_color, 1.0)[:, None, None, :]
    fresnel = f0 + (1 - f0) * s
    dielectric = (1 - weight * fresnel.max(axis=-1, keepdims=True)) * base / np.pi + weight * fresnel * lobe
    metal = (base + (1 - base) * s) * lobe
    return (1 - m) * dielectric + m * metal


def blender_brdf(slices: BrdfSlice, base_color: Array, specular_color: Array) -> Array:
    """Blender's Principled BSDF at ior 1000: measured to reflect the specular tint at all angles, without Fresnel."""
    transmitted = 1 - specular_color.max(axis=-1)[:, None, None, None]
    diffuse = transmitted * base_color[:, None, None, :] / np.pi
    return diffuse + specular_color[:, None, None, :] * slices.lobe[..., None]


def specular_workflow_brdf(slices: BrdfSlice, diffuse: Array, specular: Array) -> Array:
    """UsdPreviewSurface's specular workflow and KHR_materials_pbrSpecularGlossiness.

    Both reflect F = specular + (1 - specular) s; the remainder of the light, 1 - max F, reaches the diffuse layer.
    """
    f0, s = specular[:, None, None, :], slices.schlick[..., None]
    transmitted = 1 - f0.max(axis=-1, keepdims=True)  # 1 - max F = (1 - max F0)(1 - s)
    return transmitted * (1 - s) * diffuse[:, None, None, :] / np.pi + (f0 + (1 - f0) * s) * slices.lobe[..., None]
