"""Shades surface points under an environment: exact irradiance, and the split sum (Karis 2013) for the lobe.

Shadows and interreflections are left out, as in real-time engines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import direction_to_latlong_uv, latlong_directions, latlong_solid_angles
from hir_exporters.light.environment_map import resample_latlong, sample_latlong
from hir_exporters.light.prefilter import prefiltered_latlong
from hir_exporters.materials.brdf_numpy import albedo_terms

Array = NDArray[np.float64]

_LEVELS: Final = ((0.0, 256), (0.2, 64), (0.4, 32), (0.6, 16), (0.8, 16), (1.0, 16))
"""Perceptual roughness and rows of the prefiltered images; values between them are interpolated."""

_IRRADIANCE_ROWS: Final = 16
_LIGHT_ROWS: Final = 64
"""Rows of the light that irradiance is summed over."""


@dataclass(frozen=True, eq=False)
class PrefilteredLight:
    """A light as lat-long images in world axes."""

    irradiance: Array
    """(H, 2H, 3)."""
    levels: list[Array]
    """(H, 2H, 3) for each roughness of `_LEVELS`."""


@dataclass(frozen=True, eq=False)
class ShadedPoints:
    """N points: colours and directions are (N, 3), scalars (N,)."""

    model: Literal["paper", "dielectric", "metallic"]
    diffuse: Array
    specular: Array
    """Albedos of the two lobes."""
    alpha: Array
    normals: Array
    views: Array


def prefiltered_light(radiance: NDArray[np.floating]) -> PrefilteredLight:
    """The light (H, 2H, 3) in world axes, ready for lookups."""
    small = resample_latlong(radiance, min(_LIGHT_ROWS, len(radiance)), 2 * min(_LIGHT_ROWS, len(radiance)))
    energy = (small * latlong_solid_angles(*small.shape[:2])[..., None]).reshape(-1, 3)
    normals = latlong_directions(_IRRADIANCE_ROWS, 2 * _IRRADIANCE_ROWS)
    cosines = np.einsum("hwk,nk->hwn", normals, latlong_directions(*small.shape[:2]).reshape(-1, 3))
    irradiance = np.einsum("hwn,nc->hwc", np.maximum(cosines, 0), energy)
    levels = [(rough, min(rows, max(len(radiance), 16))) for rough, rows in _LEVELS]
    return PrefilteredLight(irradiance, prefiltered_latlong(radiance, levels))


def shaded(points: ShadedPoints, light: PrefilteredLight) -> Array:
    """Radiance (N, 3) towards the camera, linear."""
    cos_o = np.clip((points.normals * points.views).sum(axis=-1), 1e-4, 1)
    reflected = 2 * cos_o[:, None] * points.normals - points.views
    scale, bias = (term[:, None] for term in albedo_terms(cos_o, points.alpha))
    if points.model == "paper":
        lobe, transmitted = points.specular * (scale + bias), np.ones_like(points.specular)
    else:
        lobe = points.specular * scale + bias
        transmitted = np.maximum(1 - lobe, 0)
    diffuse = transmitted * points.diffuse * irradiance_over_pi(points.normals, light)
    return np.asarray(diffuse + lobe * _reflection(reflected, np.sqrt(points.alpha), light))


def irradiance_over_pi(normals: Array, light: PrefilteredLight) -> Array:
    """(N, 3) radiance of a white diffuse surface."""
    return np.asarray(sample_latlong(light.irradiance, direction_to_latlong_uv(normals)) / np.pi)


def _reflection(directions: Array, roughness: Array, light: PrefilteredLight) -> Array:
    """Prefiltered radiance (N, 3), linear between the two levels next to each roughness (N,)."""
    knots = np.array([rough for rough, _ in _LEVELS])
    position = np.interp(roughness, knots, np.arange(len(knots)))
    lower = np.minimum(position.astype(np.int64), len(knots) - 2)
    uv, result = direction_to_latlong_uv(directions), np.empty(directions.shape)
    for index in np.unique(lower):
        chosen = lower == index
        share = (position[chosen] - index)[:, None]
        narrow, wide = (sample_latlong(light.levels[k], uv[chosen]) for k in (index, index + 1))
        result[chosen] = (1 - share) * narrow + share * wide
    return result
