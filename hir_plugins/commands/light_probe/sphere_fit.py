"""A sphere from its outlines: the rays through an outline touch the sphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera
from hir_core.errors import InputError

BORDER_PIXELS = 1.5
"""Points of an outline that are nearer to the image's border are those of the border."""
MIN_POINTS = 24
"""Of an outline; fewer do not show a circle."""
MAX_DEVIATION = 0.03
"""Median distance of the outlines from those of the sphere, as a share of its radius in pixels: more is no ball."""


@dataclass(frozen=True)
class Sphere:
    """A sphere in the world, and how well it explains the outlines."""

    center: Array
    radius: float
    """In units of the world; arbitrary where all photographs were taken from one place."""
    deviation_pixels: float
    """Median distance of the outlines from those of the sphere."""


def fit_sphere(outlines: Sequence[tuple[Camera, NDArray[np.float32]]]) -> Sphere:
    """The sphere whose silhouettes are the masks; `InputError` where no sphere has them.

    From one place the distance is unknown, and the sphere's is that between the camera and one unit before it.
    """
    from scipy.optimize import least_squares

    rays = [found for camera, mask in outlines if (found := _outline_rays(camera, mask)) is not None]
    if not rays:
        raise InputError("no mask shows the outline of a ball; each needs one region that the image does not cut")
    axes = [directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0)) for _, directions, _ in rays]
    sines = [float(np.median(np.linalg.norm(np.cross(d, a), axis=1))) for (_, d, _), a in zip(rays, axes, strict=True)]
    eyes = np.stack([eye for eye, _, _ in rays])
    center, distance = _common_point(eyes, np.stack(axes))
    unit = float(np.mean(distance))
    radius = float(np.median(np.array(sines) * distance))

    def deviations(values: Array) -> Array:
        found = []
        for eye, directions, focal in rays:
            offset = values[:3] * unit - eye
            away = np.linalg.norm(np.cross(offset, directions), axis=1) - unit * np.exp(values[3])
            found.append(focal * away / np.linalg.norm(offset))
        return np.concatenate(found)

    def residuals(values: Array) -> Array:
        # the distance is not observed from one place: it stays at its first value
        depth = np.linalg.norm(values[:3] * unit - eyes[0]) / distance[0] - 1
        return np.append(deviations(values), depth) if _from_one_place(eyes, unit) else deviations(values)

    start = np.append(center / unit, np.log(max(radius, 1e-9 * unit) / unit))
    found = least_squares(residuals, start, loss="soft_l1").x
    center, radius = found[:3] * unit, float(unit * np.exp(found[3]))
    deviation = float(np.median(np.abs(deviations(found))))
    pixels = float(np.median([f * radius / np.linalg.norm(center - eye) for eye, _, f in rays]))
    if not np.isfinite(found).all() or deviation > MAX_DEVIATION * pixels:
        raise InputError(
            f"the masks are not those of one ball: their outlines deviate by {deviation:.1f} pixels from a sphere of "
            f"{pixels:.0f} pixels radius; give masks of the ball alone, and cameras of these photographs"
        )
    return Sphere(center, radius, deviation)


def _outline_rays(camera: Camera, mask: NDArray[np.float32]) -> tuple[Array, Array, float] | None:
    """Eye (3,), unit directions (N, 3) through the longest outline of a mask, and focal length in pixels."""
    from skimage.measure import find_contours

    contours = find_contours(np.asarray(mask, np.float64), 0.5)
    if not contours:
        return None
    pixels = max(contours, key=len)[:, ::-1] + 0.5
    far = (pixels > BORDER_PIXELS).all(axis=1)
    far &= (pixels < np.array([camera.width, camera.height]) - BORDER_PIXELS).all(axis=1)
    if far.sum() < MIN_POINTS:
        return None
    _, directions = camera.rays(pixels[far])
    return camera.center, directions, float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1]) / 2


def _common_point(eyes: Array, axes: Array) -> tuple[Array, Array]:
    """The point (3,) nearest to all rays (N, 3), (N, 3), and its distance (N,) from each eye; one unit before the eye
    for rays from one place."""
    projections = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    matrix = projections.sum(axis=0)
    if np.linalg.svd(matrix, compute_uv=False)[-1] < 1e-6 * len(eyes):
        return eyes[0] + axes[0], np.ones(len(eyes))
    center = np.linalg.solve(matrix, np.einsum("nij,nj->i", projections, eyes))
    return center, np.linalg.norm(center - eyes, axis=1)


def _from_one_place(eyes: Array, unit: float) -> bool:
    return float(np.ptp(eyes, axis=0).max()) < 1e-3 * unit
