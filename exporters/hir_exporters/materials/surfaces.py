"""The material parameters of the target formats: metallic-roughness with extensions, and the specular workflow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


@dataclass(frozen=True)
class MetallicSurface:
    """Parameters of glTF 2.0 with KHR_materials_specular and _ior; with weight and colour 1 and ior 1.5 the core alone.

    Colours are (H, W, 3) or (3,), the others (H, W) or (), all linear float32; `roughness` is sqrt(alpha).
    """

    base_color: Array
    metallic: Array
    roughness: Array
    specular_weight: Array
    specular_color: Array
    """Factor of the reflectance that `ior` gives; may exceed 1."""
    ior: float
    residual: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class SpecularSurface:
    """Diffuse and specular colour and sqrt(alpha): specular-glossiness and UsdPreviewSurface's specular workflow."""

    diffuse: Array
    specular: Array
    roughness: Array
    residual: float
    warnings: tuple[str, ...] = ()


def default_surface() -> MetallicSurface:
    """The surface of a mesh without a material: grey, half rough, not metal."""
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
