"""Errors of a light against the true one: per texel up to a scale, and of three spheres under both lights.

Parts of a light that no surface reflects are not observable, so the effect on objects counts more than texels. The
three spheres are those of DeepLight (LeGendre et al. 2019): mirror, matte silver, diffuse.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from hir_exporters.conventions import direction_to_latlong_uv, latlong_directions, latlong_solid_angles
from hir_exporters.light.environment_map import resample_latlong, sample_latlong
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS: Final = 64
"""Lights are compared as lat-long images of ROWS × 2 ROWS; texels are weighted by solid angle."""

SPHERE_PIXELS: Final = 48
MATTE_ROWS: Final = 32
SILVER_ALPHA: Final = 0.3
"""GGX width of the matte silver sphere."""

SPHERES: Final = ("mirror", "silver", "diffuse")


@dataclass(frozen=True)
class LightFigures:
    """Relative errors, each after the scalar that minimises it."""

    scale: float
    """Least-squares factor from the fitted to the true texels."""
    texels: float
    """Root mean square difference over the sphere of directions, over the truth's root mean square."""
    spheres: Mapping[str, float]
    """The same over the pixels of each sphere, with a scale per sphere."""
    angular_deg: Mapping[str, float]
    """Mean angle between RGB vectors of both images of each sphere: the error of colour alone."""

    def document(self) -> dict[str, Any]:
        """For metrics.json."""
        return {
            "scale": self.scale,
            "texels": self.texels,
            "spheres": dict(self.spheres),
            "angular_deg": dict(self.angular_deg),
        }


def compare_lights(fit: NDArray[np.floating], truth: NDArray[np.floating]) -> LightFigures:
    """Figures of two lat-long lights (H, W, 3) in the same axes, of any sizes."""
    ours, theirs = (resample_latlong(light, ROWS, 2 * ROWS) for light in (fit, truth))
    weight = np.broadcast_to(latlong_solid_angles(ROWS, 2 * ROWS), (ROWS, 2 * ROWS))
    scale, texels = scale_invariant_error(ours, theirs, weight)
    errors, angles = {}, {}
    ours_lit, theirs_lit = three_spheres(ours), three_spheres(theirs)
    inside = np.broadcast_to(1.0, next(iter(ours_lit.values())).shape[:-1])
    for name in SPHERES:
        errors[name] = scale_invariant_error(ours_lit[name], theirs_lit[name], inside)[1]
        angles[name] = angular_error_deg(ours_lit[name], theirs_lit[name])
    return LightFigures(scale, texels, errors, angles)


def scale_invariant_error(fit: Array, truth: Array, weight: Array) -> tuple[float, float]:
    """The least-squares scale of `fit` (…, 3), and the remaining relative error; `weight` (…) per element."""
    w = weight[..., None]
    power = float((w * fit * fit).sum())
    scale = float((w * fit * truth).sum()) / power if power > 0 else 0.0
    size = float((w * truth * truth).sum())
    left = float((w * (scale * fit - truth) ** 2).sum())
    return scale, float(np.sqrt(left / size)) if size > 0 else 0.0


def angular_error_deg(fit: Array, truth: Array) -> float:
    """Mean angle between RGB vectors (…, 3), where both are lit."""
    ours, theirs = np.linalg.norm(fit, axis=-1, keepdims=True), np.linalg.norm(truth, axis=-1, keepdims=True)
    lit = (ours * theirs)[..., 0] > 1e-12
    if not lit.any():
        return 0.0
    a, b = fit[lit] / ours[lit], truth[lit] / theirs[lit]
    # Kahan 2006: acos of the cosine has lost every angle below 1e-8 rad
    angle = 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return float(np.degrees(angle).mean())


def three_spheres(radiance: Array, pixels: int = SPHERE_PIXELS) -> dict[str, Array]:
    """Radiance (P, 3) of the pixels of a mirror, a silver and a diffuse white sphere, seen along −Z from far away.

    The silver sphere has a GGX lobe of width `SILVER_ALPHA` without Fresnel and shadowing-masking, normalised so that
    it reflects all light: the mean of the light under `D(h) h·n`. `sphere_normals` has the pixels. The silver and
    diffuse spheres use the light at `MATTE_ROWS`.
    """
    normals = sphere_normals(pixels)
    rows, columns = MATTE_ROWS, 2 * MATTE_ROWS
    directions = latlong_directions(rows, columns).reshape(-1, 3)
    solid = np.repeat(latlong_solid_angles(rows, columns)[:, 0], columns)
    flux = resample_latlong(radiance, rows, columns).reshape(-1, 3) * solid[:, None]
    view = np.array([0.0, 0.0, 1.0])
    mirrored = 2 * (normals @ view)[:, None] * normals - view
    diffuse = np.maximum(normals @ directions.T, 0) @ flux / np.pi
    half = directions + view
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    cosine = np.maximum(normals @ half.T, 0)
    lobe = cosine / (cosine**2 * (SILVER_ALPHA**2 - 1) + 1) ** 2
    lobe *= (normals @ directions.T) > 0
    silver = lobe @ flux / np.maximum(lobe @ solid, 1e-300)[:, None]
    return {"mirror": sample_latlong(radiance, direction_to_latlong_uv(mirrored)), "silver": silver, "diffuse": diffuse}


def sphere_normals(pixels: int = SPHERE_PIXELS) -> Array:
    """Unit normals (P, 3) of the sphere's visible pixels, row by row from the top."""
    ticks = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    x, y = np.meshgrid(ticks, -ticks)
    inside = x**2 + y**2 < 0.98
    return np.stack([x[inside], y[inside], np.sqrt(1 - x[inside] ** 2 - y[inside] ** 2)], axis=1)
