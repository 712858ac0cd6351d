"""Triangles of polygons in space: each polygon is a fan around one of its corners."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_COMPARED: Final = 64
"""Polygons of more corners are a fan around the first one: the time of the comparison grows with the square."""

_TOLERANCE: Final = 1e-6
"""Part of the polygon's area by which a triangle may be turned over: rounding of coordinates in text."""


def triangle_corners(positions: NDArray[np.float64], sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Corners (T, 3) of the triangles of polygons, and how many polygons are not covered without an overlap.

    `positions` (C, 3) are those of the corners, `sizes` (F,) the corners of each polygon. Quads, and all polygons that
    are convex or see all of themselves from one corner, are covered exactly. Polygons of fewer than three corners have
    no triangles.
    """
    first = np.cumsum(sizes) - sizes
    center = np.zeros(len(sizes), np.int64)
    overlapping = 0
    for size in np.unique(sizes[sizes > 3]):
        chosen = np.flatnonzero(sizes == size)
        with np.errstate(invalid="ignore", over="ignore"):  # positions that are rejected later
            center[chosen], count = _fan_centers(positions, first[chosen], int(size))
        overlapping += count
    triangles = np.maximum(sizes - 2, 0)
    face = np.repeat(np.arange(len(sizes)), triangles)
    step = np.arange(len(face)) - np.repeat(np.cumsum(triangles) - triangles, triangles) + 1
    around = np.stack([np.zeros_like(step), step, step + 1], axis=1) + center[face, None]
    return first[face, None] + around % np.maximum(sizes[face, None], 1), overlapping


def _fan_centers(positions: NDArray[np.float64], first: NDArray[np.int64], size: int) -> tuple[NDArray[np.int64], int]:
    """The first corner of each polygon around which no triangle is turned over, else 0; and how many have none."""
    centers = np.zeros(len(first), np.int64)
    pending = np.arange(len(first))
    for center in range(size if size <= MAX_COMPARED else 1):
        polygons = positions[first[pending, None] + (np.arange(size) + center) % size]
        edges = polygons[:, 1:] - polygons[:, :1]
        areas = np.cross(edges[:, :-1], edges[:, 1:])
        normal = areas.sum(axis=1)
        along = np.einsum("pti,pi->pt", areas, normal)
        covered = along.min(axis=1) >= -_TOLERANCE * (normal**2).sum(axis=1)
        centers[pending[covered]] = center
        pending = pending[~covered]
        if not len(pending):
            break
    return centers, len(pending)
