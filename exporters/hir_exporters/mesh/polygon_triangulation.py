"""Divides polygons into triangles: by a fan where that is right, else by clipping ears (Meisters 1975)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_CONCAVE_CORNERS: Final = 1000
"""Polygons of more corners are a fan: the time of clipping ears grows with their square or more."""

_TOLERANCE: Final = 1e-6
"""Of areas, relative to that of the polygon: coordinates are rounded to float32 or to a few digits of text."""

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def triangulate(counts: Indices, corners: Array) -> tuple[Indices, Indices, int]:
    """Corner indices (T, 3) of triangles, the polygon (T,) of each, and how many polygons have triangles that overlap.

    `counts` (F,) are the corners of each polygon, `corners` (C, 3) their positions, one polygon after the other; the
    triangles are in the order of the polygons. Polygons of fewer than three corners have no area and no triangle.
    Those that cross themselves, or are concave with very many corners, are a fan, whose triangles overlap.
    """
    if (counts == 3).all():
        return np.arange(3 * len(counts)).reshape(-1, 3), np.arange(len(counts)), 0
    offsets = np.cumsum(counts) - counts
    triangles, polygons, overlapping = [], [], 0
    for count in np.unique(counts[counts >= 3]):
        group = np.flatnonzero(counts == count)
        indices = offsets[group, None] + np.arange(count)
        with np.errstate(invalid="ignore", over="ignore"):  # positions that are refused later
            local, failed = _triangles(corners[indices])
        overlapping += failed
        triangles.append(np.take_along_axis(indices[:, None], local.reshape(len(group), 1, -1), axis=2).reshape(-1, 3))
        polygons.append(np.repeat(group, count - 2))
    if not triangles:
        return np.empty((0, 3), np.int64), np.empty(0, np.int64), 0
    polygon = np.concatenate(polygons)
    order = np.argsort(polygon, kind="stable")
    return np.concatenate(triangles)[order], polygon[order], overlapping


def _triangles(corners: Array) -> tuple[Indices, int]:
    """Triangles (G, n - 2, 3) of polygons (G, n, 3) with the same number of corners, and how many overlap."""
    count = corners.shape[1]
    middle = np.arange(1, count - 1)
    fan = np.stack([0 * middle, middle, middle + 1], axis=1)
    triangles = np.repeat(fan[None], len(corners), axis=0)
    if count == 3:
        return triangles, 0
    edges = corners[:, 1:] - corners[:, :1]
    normals = np.cross(edges[:, :-1], edges[:, 1:]).sum(axis=1)
    concave = np.flatnonzero(_overlap(corners, fan, normals))
    if count == 4:
        other = np.array([[1, 2, 3], [1, 3, 0]])
        triangles[concave] = other
        return triangles, int(_overlap(corners[concave], other, normals[concave]).sum())
    failed = 0
    for index in concave:
        clipped = _clipped_ears(corners[index], normals[index])
        if clipped is None:
            failed += 1
        else:
            triangles[index] = clipped
    return triangles, failed


def _overlap(corners: Array, triangles: Indices, normals: Array) -> NDArray[np.bool_]:
    """Which polygons (G, n, 3) have a triangle of `triangles` (T, 3) that is turned over, or triangles that cancel."""
    at = corners[:, triangles]
    areas = np.cross(at[:, :, 1] - at[:, :, 0], at[:, :, 2] - at[:, :, 0])
    limits = -_TOLERANCE * np.square(normals).sum(axis=1)
    turned = (np.einsum("gtc,gc->gt", areas, normals) < limits[:, None]).any(axis=1)
    # a polygon whose halves cancel has no normal that a triangle could be turned from
    total = np.linalg.norm(areas, axis=2).sum(axis=1)
    return np.asarray(turned | (np.linalg.norm(normals, axis=1) < _TOLERANCE * total))


def _clipped_ears(corners: Array, normal: Array) -> Indices | None:
    """Triangles (n - 2, 3) of one polygon (n, 3); None where it crosses itself or has too many corners."""
    if len(corners) > MAX_CONCAVE_CORNERS or not normal.any():
        return None
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
            return None
    a, b, c = plane[remaining]
    return None if _cross(b - a, c - a) < -limit else np.asarray([*triangles, remaining])


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
