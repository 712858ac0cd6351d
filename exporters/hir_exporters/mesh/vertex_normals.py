"""Normals of vertices from the triangles around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def angle_weighted_normals(points: Array, faces: NDArray[np.integer]) -> Array:
    """Unit normals (V, 3): the mean of the triangles at each point, weighted by their angles (Thürmer & Wüthrich 1998).

    +Y where a point has no triangle with an area. `points` (V, 3), `faces` (T, 3).
    """
    corners = np.asarray(points, np.float64)[faces]
    with np.errstate(invalid="ignore", over="ignore"):  # numbers that `validate_asset` refuses
        after, before = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        normals = np.cross(after, before)
        sine, cosine = np.linalg.norm(normals, axis=-1), (after * before).sum(axis=-1)
        weighted = unit_or_zero(normals) * np.arctan2(sine, cosine)[..., None]
        sums = [np.bincount(np.ravel(faces), axis, len(points)) for axis in weighted.reshape(-1, 3).T]
        summed = unit_or_zero(np.stack(sums, axis=-1))
    return np.where(summed.any(axis=-1, keepdims=True), summed, [0.0, 1.0, 0.0])


def unit_or_zero(vectors: Array) -> Array:
    """Unit vectors (..., 3); 0 for those without a length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-30, vectors / np.maximum(length, 1e-30), 0.0)
