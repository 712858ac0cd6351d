"""Base colours for engines that add multiple scattering inside the lobe, which the models of this project do not have.

three.js, Babylon.js and Filament scale the lobe by 1 + F0 (1 / E - 1), where E is its albedo without Fresnel and with
Smith's height-correlated G (Turquin 2019, eq. 16; three.js does so for its lights, and adds nearly the same light under
an environment). The base colour of metals is changed so that the scaled lobe reflects as much light as the model's,
averaged over the view directions of a distant sphere.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials.brdf_numpy import albedo_terms, integrate_albedo
from hir_exporters.materials.brdf_slice import VIEW_COSINES
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.textures.bilinear import sample_bilinear
from hir_exporters.textures.texture_maps import common_size, map_in_strips, resize

Array = NDArray[np.floating]

_ROUGHNESSES: Final = 33
_COLORS: Final = 65


def engine_base_color(surface: MetallicSurface) -> MetallicSurface:
    """The surface with the base colour that looks in those engines as `surface` does in the model.

    Only metal changes: the new base colour is weighted by metalness.
    """
    if not np.any(surface.metallic > 0):
        return surface
    values, channels = (surface.base_color, surface.metallic, surface.roughness), (1, 0, 0)
    size = common_size(*values, channels=channels)
    base, metallic, roughness = (
        resize(value, *size) if size and value.ndim - c == 2 else value
        for value, c in zip(values, channels, strict=True)
    )
    changed = map_in_strips(_compensated, (base, 1), (metallic, 0), (roughness, 0))
    return replace(surface, base_color=changed)


def _compensated(base: Array, metallic: Array, roughness: Array) -> NDArray[np.float32]:
    lowest = np.sqrt(ALPHA_MIN)
    row = (np.clip(roughness, lowest, 1) - lowest) / (1 - lowest) * (_ROUGHNESSES - 1)
    color = sample_bilinear(_table()[..., None], base * (_COLORS - 1), row[..., None])[..., 0]
    return np.asarray(base + (color - base) * metallic[..., None], np.float32)


@cache
def _table() -> NDArray[np.float64]:
    """Compensated colours (33, 65): rows evenly spaced in roughness from sqrt(ALPHA_MIN), columns in F0 from 0 to 1."""
    alpha = np.linspace(np.sqrt(ALPHA_MIN), 1, _ROUGHNESSES)[:, None] ** 2
    f0 = np.linspace(0, 1, _COLORS)
    engine = engine_albedo(VIEW_COSINES[None, :, None], alpha[..., None], f0).mean(axis=1)
    scale, bias = albedo_terms(VIEW_COSINES[None, :], alpha)
    model = (f0 * scale[..., None] + bias[..., None]).mean(axis=1)
    table = np.stack([np.interp(m, e, f0) for m, e in zip(model, engine, strict=True)])
    table.setflags(write=False)
    return table


def engine_albedo(cos_theta: Array, alpha: Array, f0: Array) -> NDArray[np.float64]:
    """Directional albedo of a metal's lobe in those engines; all arguments broadcast."""
    scale, bias = integrate_albedo(cos_theta, alpha, correlated=True)
    return np.asarray((f0 * scale + bias) * multiple_scattering(f0, scale + bias), np.float64)


def multiple_scattering(f0: Array, albedo: Array) -> Array:
    """The factor of the lobe, 1 + F0 (1 / E - 1), for its albedo E without Fresnel."""
    return 1 + f0 * (1 / np.maximum(albedo, 1e-3) - 1)
