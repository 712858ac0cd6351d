"""Which triangle covers which texel of a texture, and where in it: scan lines, all triangles at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class TexelCoverage:
    """The N texels of a `size`² texture whose middles lie in a triangle; each once."""

    size: int
    texels: Indices
    """(N,) row * size + column."""
    faces: Indices
    """(N,) the triangle; the last one where several overlap."""
    weights: Array
    """(N, 3) barycentric coordinates."""
    overlap: float
    """Share of the triangles' texels that an other one covers, too."""

    def interpolated(self, values: NDArray[np.floating], corners: NDArray[np.integer]) -> Array:
        """Values (V, C) of vertices at the texels (N, C); `corners` (F, 3) are the vertices of each triangle."""
        return np.asarray(np.einsum("nk,nkc->nc", self.weights, values[corners[self.faces]].astype(np.float64)))


def rasterize_uvs(uvs: NDArray[np.floating], faces: NDArray[np.integer], size: int) -> TexelCoverage:
    """Triangles (F, 3) with texture coordinates (V, 2), origin top-left, over a `size`² texture.

    A middle on an edge belongs to one of its two triangles; coordinates outside of [0, 1] cover nothing.
    """
    corners = uvs.astype(np.float64)[faces] * size - 0.5  # middles of texels are whole numbers
    low, high = corners[..., 1].min(axis=1), corners[..., 1].max(axis=1)
    first, last = np.maximum(np.ceil(low), 0).astype(np.int64), np.minimum(np.ceil(high), size).astype(np.int64)
    face, row = _spans(first, last)
    start, end = _crossings(corners[face], row)
    begin, stop = (np.clip(np.ceil(x), 0, size).astype(np.int64) for x in (start, end))
    line, column = _spans(begin, stop)
    face, row = face[line], row[line]
    texels, kept = np.unique((row * size + column)[::-1], return_index=True)
    kept = len(face) - 1 - kept
    overlap = 1 - len(texels) / len(face) if len(face) else 0.0
    weights = _barycentric(corners[face[kept]], np.stack([column[kept], row[kept]], axis=-1).astype(np.float64))
    return TexelCoverage(size, texels, face[kept], weights, overlap)


def dilate(values: NDArray[np.float32], known: NDArray[np.bool_], steps: int) -> NDArray[np.float32]:
    """A texture (H, W, C) grown into texels that are not `known`, one ring a step: the mean of known neighbours."""
    values, known = values.copy(), known.copy()
    for _ in range(steps):
        if known.all():
            break
        padded = np.pad(np.where(known[..., None], values, 0), ((1, 1), (1, 1), (0, 0)))
        counts = np.pad(known.astype(np.float32), 1)
        total, count = np.zeros_like(values), np.zeros(known.shape, np.float32)
        height, width = known.shape
        for y, x in ((0, 1), (2, 1), (1, 0), (1, 2), (0, 0), (0, 2), (2, 0), (2, 2)):
            total += padded[y : y + height, x : x + width]
            count += counts[y : y + height, x : x + width]
        ring = ~known & (count > 0)
        values[ring] = total[ring] / count[ring][:, None]
        known |= ring
    return values


def _spans(first: Indices, last: Indices) -> tuple[Indices, Indices]:
    """For each number in first..last - 1 of each item: the item and the number."""
    count = np.maximum(last - first, 0)
    item = np.repeat(np.arange(len(count)), count)
    return item, np.arange(len(item)) - np.repeat(np.cumsum(count) - count, count) + first[item]


def _crossings(corners: Array, row: Indices) -> tuple[Array, Array]:
    """Where the triangle's border crosses the middle of the row: left and right."""
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):
        (ax, ay), (bx, by) = corners[:, k].T, corners[:, (k + 1) % 3].T
        crosses = (ay < row) != (by < row)
        x = ax + (row - ay) / np.where(crosses, by - ay, 1.0) * (bx - ax)
        left = np.where(crosses, np.minimum(left, x), left)
        right = np.where(crosses, np.maximum(right, x), right)
    return np.where(np.isfinite(left), left, 0.0), np.where(np.isfinite(right), right, 0.0)


def _barycentric(corners: Array, place: Array) -> Array:
    a, b, c = corners.transpose(1, 0, 2)
    area = _cross(b - a, c - a)
    safe = np.where(np.abs(area) > 1e-300, area, 1.0)
    second, third = _cross(place - a, c - a) / safe, _cross(b - a, place - a) / safe
    return np.stack([1 - second - third, second, third], axis=-1)


def _cross(u: Array, v: Array) -> Array:
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
