"""Markers in space: their corners from several photographs, and the scale and the level that follow from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera
from hir_plugins.initializers.markers.marker_detection import MIN_VIEWS, SeenMarker

Corners = NDArray[np.float64]
"""The corners of a marker in space, 4 3. No jaxtyping: an alias is evaluated, and numpy 2.5's NDArray is no class."""
MAX_ERROR_PIXELS = 2.0
"""Photographs in which a corner lies farther than this from its projection are wrong detections or wrong cameras."""
MIN_EIGENVALUE = 1e-4
"""Least eigenvalue of the mean projection across the rays: below, all photographs look from one side."""
MAX_DEGREES_FROM_VERTICAL = 45.0
"""Markers whose front is farther from the vertical lie on a wall or on the object, and say nothing about the level."""
MAX_DISAGREEMENT_DEGREES = 5.0
"""Fronts of markers that lie on one table agree to this."""


@dataclass(frozen=True)
class MarkerScale:
    """Metres per unit of the world."""

    metres_per_unit: float
    markers: int
    relative_deviation: float
    """Standard deviation of the measured sides over their mean."""


def corners_in_space(seen: Sequence[SeenMarker], cameras: Sequence[Camera]) -> Corners | None:
    """The corners of one marker in the world by least squares over its photographs; None where they contradict.

    Photographs that disagree are left out one by one, the worst first, while two and more than half remain: a few of
    many wrong ones agree by chance.
    """
    kept = list(seen)
    while len(kept) >= MIN_VIEWS and 2 * len(kept) > len(seen):
        corners = _intersection([cameras[each.view].rays(each.corners) for each in kept])
        if corners is None:
            return None
        errors = np.array([_projection_error(cameras[each.view], corners, each.corners) for each in kept])
        if errors.max() <= MAX_ERROR_PIXELS:
            return corners
        del kept[int(errors.argmax())]
    return None


def scale_of_markers(corners: Mapping[int, Corners], side: float) -> MarkerScale:
    """The scale from markers whose black square has sides of `side` metres: the median over the markers."""
    sides = np.array([np.linalg.norm(c - np.roll(c, 1, axis=0), axis=1) for c in corners.values()])
    middle = float(np.median(sides.mean(axis=1)))
    return MarkerScale(side / middle, len(corners), float(sides.std() / middle))


def front_of_markers(corners: Mapping[int, Corners]) -> Array | None:
    """The unit normal of the table on which the markers lie, away from it; None where they lie in several planes."""
    normals = []
    for a, b, c, d in corners.values():
        normal = np.cross(c - a, b - d)  # towards the viewer who sees the corners clockwise
        normals.append(normal / np.linalg.norm(normal))
    mean = np.mean(normals, axis=0)
    mean /= np.linalg.norm(mean)
    if np.degrees(np.arccos(np.clip(np.array(normals) @ mean, -1, 1))).max() > MAX_DISAGREEMENT_DEGREES:
        return None
    points = np.concatenate(list(corners.values()))
    points = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    plane: Array = axes[2] * np.sign(axes[2] @ mean)
    # several markers far apart give a far better normal than each alone; on two heights they give none
    return plane if plane @ mean > np.cos(np.radians(MAX_DISAGREEMENT_DEGREES)) else np.asarray(mean)


def levelling_rotation(front: Array) -> tuple[Array, float]:
    """The smallest rotation (4×4) that turns `front` to +Y, and its angle in degrees."""
    up = np.array([0.0, 1.0, 0.0])
    axis, cosine = np.cross(front, up), float(np.clip(front @ up, -1, 1))
    sine = float(np.linalg.norm(axis))
    rotation = np.eye(4)
    if sine > 1e-12:
        x, y, z = axis / sine
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation[:3, :3] += sine * cross + (1 - cosine) * cross @ cross
    return rotation, float(np.degrees(np.arctan2(sine, cosine)))


def _intersection(rays: Sequence[tuple[Array, Array]]) -> Corners | None:
    """The points nearest to the rays of each corner; None where all rays come from one side."""
    found = []
    for corner in range(4):
        directions = np.array([d[corner] for _, d in rays])
        origins = np.array([o[corner] for o, _ in rays])
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        if np.linalg.eigvalsh(across.mean(axis=0))[0] < MIN_EIGENVALUE:
            return None
        found.append(np.linalg.solve(across.sum(axis=0), (across @ origins[..., None]).sum(axis=0)[:, 0]))
    return np.array(found)


def _projection_error(camera: Camera, corners: Corners, seen: Array) -> float:
    pixels, depth = camera.project(corners)
    return float(np.linalg.norm(pixels - seen, axis=1).max()) if (depth > 0).all() else np.inf
