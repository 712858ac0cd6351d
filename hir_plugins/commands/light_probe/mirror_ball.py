"""The light around a mirror ball (Debevec 1998, light probes), from photographs with cameras and recorded exposures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from hir_exporters.light.environment_map import resample_latlong
from hir_exporters.textures.bilinear import sample_bilinear
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, View
from hir_core.errors import InputError
from hir_plugins.commands.light_probe.sphere_fit import Sphere

MAX_FINE_ROWS = 1024
"""Of the image that photographs are sampled for, before it is averaged."""
LEAST_COSINE, FULL_COSINE = 0.1, 0.3
"""Between the ball's normal and the direction to the camera: pixels nearer to the outline mix with what is behind."""
PHOTOGRAPHER_DEGREES = 5.0, 15.0
"""Directions nearer to the camera than the first show the photographer; from the second on they count fully."""
SHOWN_ANYWAY = 1e-3
"""Weight of the photographer, who is better than nothing."""
WHOLE_COVERAGE = 0.99
ITERATIONS = 8
"""Of the point that reflects a direction into a camera; each reduces the error by the radius over the distance."""


@dataclass(frozen=True, eq=False)
class LightProbe:
    """The measured light."""

    radiance: NDArray[np.float32]
    """H 2H 3, lat-long."""
    clipped_texels: NDArray[np.bool_]
    """H 2H: where a part is clipped in every photograph that shows it, so that the light is brighter than this."""
    clipped: float
    """Share of all directions, by solid angle, that are clipped in every photograph that shows them."""
    unseen: float
    """Share that no photograph shows; filled from its surroundings."""


def mirror_ball_light(
    views: Sequence[View], ball: Sphere, world_from_file: Array, rows: int, reflectance: float
) -> LightProbe:
    """Radiance of all directions of a lat-long image of `rows` rows, whose axes `world_from_file` (3×3) turns.

    Each photograph is radiance × reflectance × `View.gain`. The light is assumed to be far away beside the ball's size.
    `InputError` where no photograph shows a reflection.
    """
    diameter = max(_diameter_pixels(view.camera, ball) for view in views if view.camera is not None)
    # as many texels as the ball has pixels: each pixel shows the same solid angle
    factor = max(1, min(math.ceil(math.sqrt(math.pi / 8) * diameter / rows), MAX_FINE_ROWS // rows))
    fine = factor * rows
    directions = latlong_directions(fine, 2 * fine).reshape(-1, 3) @ world_from_file.T
    total, weights = np.zeros((len(directions), 3)), np.zeros(len(directions))
    bound, is_clipped = np.zeros((len(directions), 3)), np.zeros(len(directions), bool)
    for view in views:
        color, weight, clipped = _seen(view, ball, directions)
        radiance = color / (view.gain * reflectance)
        used = np.where(clipped, 0.0, weight * float(view.gain.mean()))
        weights += used
        total += used[:, None] * radiance
        shown = clipped & (weight > 0)
        is_clipped |= shown
        bound[shown] = np.maximum(bound[shown], radiance[shown])  # the shortest exposure says most
    is_clipped &= weights == 0
    seen = is_clipped | (weights > 0)
    if not seen.any():
        raise InputError("no photograph shows a reflection in the ball; it is too small, or its masks are too soft")
    mean = np.where(is_clipped[:, None], bound, total / np.maximum(weights, 1e-300)[:, None])
    shape = fine, 2 * fine
    solid = np.broadcast_to(latlong_solid_angles(*shape), shape).reshape(-1) / (4 * math.pi)
    known = resample_latlong(seen.astype(np.float64).reshape(*shape, 1), rows, 2 * rows)
    averaged = resample_latlong(np.where(seen[:, None], mean, 0).reshape(*shape, 3), rows, 2 * rows)
    filled = _filled(averaged / np.maximum(known, 1e-12), known[..., 0] > 0)
    texels = np.asarray(is_clipped.reshape(rows, factor, 2 * rows, factor).any(axis=(1, 3)), bool)
    return LightProbe(filled.astype(np.float32), texels, float(solid[is_clipped].sum()), float(solid[~seen].sum()))


def reflecting_pixels(camera: Camera, ball: Sphere, directions: Array) -> tuple[Array, Array, Array]:
    """Where a camera sees each direction (N, 3) reflected: pixels (N, 2), cosine (N,) between the ball's normal and the
    direction to the camera, and unit directions to the camera (N, 3).
    """
    toward = np.broadcast_to(camera.center - ball.center, directions.shape)
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    for _ in range(ITERATIONS):
        half = directions + toward
        normal = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
        toward = camera.center - (ball.center + ball.radius * normal)
        toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    pixels, _ = camera.project(ball.center + ball.radius * normal)
    return pixels, np.einsum("ij,ij->i", normal, toward), toward


def _seen(view: View, ball: Sphere, directions: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Linear colour (N, 3) of a photograph where it shows each direction, weight (N,), and whether it is clipped."""
    assert view.camera is not None
    at, cosine, toward = reflecting_pixels(view.camera, ball, directions)
    pixels = view.pixels()
    assert pixels.mask is not None
    x, y = at[:, 0] - 0.5, at[:, 1] - 0.5
    height, width = pixels.mask.shape
    inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    covered = sample_bilinear(pixels.mask[..., None], x, y)[:, 0] > WHOLE_COVERAGE
    angle = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", directions, toward), -1, 1)))
    weight = np.clip((cosine - LEAST_COSINE) / (FULL_COSINE - LEAST_COSINE), 0, 1)
    near, far = PHOTOGRAPHER_DEGREES
    weight = weight * np.clip((angle - near) / (far - near), SHOWN_ANYWAY, 1) * (inside & covered)
    clipped = sample_bilinear(pixels.saturated[..., None].astype(np.float32), x, y)[:, 0] > 0
    return np.asarray(sample_bilinear(pixels.color_linear, x, y), np.float64), weight, clipped


def _diameter_pixels(camera: Camera, ball: Sphere) -> float:
    distance = float(np.linalg.norm(camera.center - ball.center))
    return 2 * float(camera.intrinsics[0, 0]) * ball.radius / distance


def _filled(radiance: Array, known: NDArray[np.bool_]) -> Array:
    """The image with unknown texels from the nearest blur that reaches them; the mean where none does."""
    from scipy.ndimage import gaussian_filter

    if known.all():
        return radiance
    filled, missing = np.where(known[..., None], radiance, 0), ~known
    weight = known.astype(np.float64)
    sigma = 1.0
    while missing.any() and sigma < 2 * len(radiance):
        modes = ("nearest", "wrap")
        reach = gaussian_filter(weight, sigma, mode=modes)
        blurred = (
            np.stack([gaussian_filter(filled[..., c] * weight, sigma, mode=modes) for c in range(3)], axis=-1)
            / np.maximum(reach, 1e-12)[..., None]
        )
        found = missing & (reach > 1e-3)
        filled[found], missing = blurred[found], missing & ~found
        sigma *= 2
    filled[missing] = radiance[known].mean(axis=0)
    return filled
