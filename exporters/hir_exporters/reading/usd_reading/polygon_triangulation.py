"""Divides polygons into triangles: by a fan where that is right, else by clipping ears (Meisters 1975)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError

MAX_CONCAVE_CORNERS: Final = 1000
"""Corners of a polygon that no fan divides: the time of its triangulation grows with their square or more."""

_TOLERANCE: Final = 1e-9
"""Of areas, relative to that of the polygon."""

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def triangulate(counts: Indices, corners: Array) -> tuple[Indices, Indices]:
    """Corner indices (T, 3) of triangles, and the polygon (T,) of each, in the order of the polygons.

    `counts` (F,) are the corners of each polygon, `corners` (C, 3) their positions, one polygon after the other.
    Polygons of fewer than three corners have no area and no triangle. Raises `InputError` for polygons that cross
    themselves, without the name of the file.
    """
    if (counts == 3).all():
        return np.arange(3 * len(counts)).reshape(-1, 3), np.arange(len(counts))
    offsets = np.cumsum(counts) - counts
    triangles, polygons = [], []
    for count in np.unique(counts[counts >= 3]):
        group = np.flatnonzero(counts == count)
        indices = offsets[group, None] + np.arange(count)
        local = _triangles(corners[indices], group)
        triangles.append(np.take_along_axis(indices[:, None], local.reshape(len(group), 1, -1), axis=2).reshape(-1, 3))
        polygons.append(np.repeat(group, count - 2))
    if not triangles:
        return np.empty((0, 3), np.int64), np.empty(0, np.int64)
    polygon = np.concatenate(polygons)
    order = np.argsort(polygon, kind="stable")
    return np.concatenate(triangles)[order], polygon[order]


def _triangles(corners: Array, polygons: Indices) -> Indices:
    """Triangles (G, n - 2, 3) of polygons (G, n, 3) with the same number of corners; `polygons` are their numbers."""
    count = corners.shape[1]
    middle = np.arange(1, count - 1)
    fan = np.stack([0 * middle, middle, middle + 1], axis=1)
    triangles = np.repeat(fan[None], len(corners), axis=0)
    if count == 3:
        return triangles
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.cross(edges[:, :-1], edges[:, 1:])
    normals = areas.sum(axis=1)
    signs = np.einsum("gnc,gc->gn", areas, normals)
    limits = -_TOLERANCE * np.square(normals).sum(axis=1)
    concave = np.flatnonzero((signs < limits[:, None]).any(axis=1))
    if count == 4:
        triangles[concave] = [[1, 2, 3], [1, 3, 0]]  # by the other diagonal
        return triangles
    for index in concave:
        triangles[index] = _clipped_ears(corners[index], normals[index], int(polygons[index]))
    return triangles


def _clipped_ears(corners: Array, normal: Array, polygon: int) -> Indices:
    """Triangles (n - 2, 3) of one polygon (n, 3)."""
    if len(corners) > MAX_CONCAVE_CORNERS:
        raise InputError(
            f"polygon {polygon} is concave and has {len(corners)} corners, more than {MAX_CONCAVE_CORNERS}; "
            "triangulate the mesh first"
        )
    plane = _projected(corners, normal)
    limit = _TOLERANCE * float(np.linalg.norm(normal))
    remaining, triangles, position, failures = list(range(len(corners))), [], 0, 0
    while len(remaining) > 3:
        position %= len(remaining)
        ear = [remaining[position - 1], remaining[position], remaining[(position + 1) % len(remaining)]]
        if _is_ear(plane, ear, remaining, limit):
            triangles.append(ear)
            del remaining[position]
            position, failures = position - 1, 0
        else:
            position, failures = position + 1, failures + 1
        if failures > len(remaining):
            break
    a, b, c = plane[remaining[:3]]
    if len(remaining) > 3 or _cross(b - a, c - a) < -limit:
        raise InputError(f"polygon {polygon} crosses itself; triangulate the mesh first")
    return np.asarray([*triangles, remaining])


def _projected(corners: Array, normal: Array) -> Array:
    """Corners (n, 2) in the plane with this normal, counter-clockwise."""
    axis = normal / np.linalg.norm(normal)
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    return (corners - corners[0]) @ np.stack([first, np.cross(axis, first)], axis=1)


def _is_ear(plane: Array, ear: list[int], remaining: list[int], limit: float) -> bool:
    """Whether the triangle has no negative area and contains no other corner; one on its border counts."""
    a, b, c = plane[ear]
    area = _cross(b - a, c - a)
    if abs(area) <= limit:  # nothing lies in it, but a spike that folds back is none
        return bool(np.dot(b - a, c - b) >= 0)
    if area < 0:
        return False
    others = plane[[index for index in remaining if index not in ear]]
    others = others[~np.any([(others == corner).all(axis=1) for corner in (a, b, c)], axis=0)]
    sides = [_cross(end - begin, others - begin) for begin, end in ((a, b), (b, c), (c, a))]
    return not np.any(np.all([side >= -limit for side in sides], axis=0))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
