"""Rasterises triangles in texture or image space: which triangle covers which texel, and where in it.

The one rasteriser of the project, in numpy; `hir_core.mesh.texel_rasterization` wraps it for tensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_CANDIDATES_PER_PASS = 500_000
"""Pairs of triangle and texel that are tested at once: bounds the memory at about 100 MB."""
_SLACK = 1e-6
"""Of barycentric weights: by rounding, a centre on the edge between two triangles would otherwise miss both."""
_STRICT = 1e-3
"""Least barycentric weight of a texel that counts as overlap."""


@dataclass(frozen=True, eq=False)
class TexelCoverage:
    """The N texels of a `size`² texture whose centres lie in a triangle; each once."""

    size: int
    texels: Indices
    """(N,) row * size + column, ascending."""
    faces: Indices
    """(N,) the triangle; the last one where several overlap."""
    weights: Array
    """(N, 3) barycentric weights, not negative, sum 1."""
    overlap: float
    """Share of the triangles' texels that another triangle covers, too; 0.5 where everything is covered twice."""

    def interpolated(self, values: NDArray[np.floating], corners: NDArray[np.integer]) -> Array:
        """Vertex values (V, C) interpolated at the texels (N, C); `corners` (F, 3) are each triangle's vertices."""
        by_face = values[corners].astype(np.float64)  # one look-up for each texel instead of three
        return np.asarray(np.einsum("nk,nkc->nc", self.weights, by_face[self.faces]))


def rasterize_uvs(uvs: NDArray[np.floating], faces: NDArray[np.integer], size: int) -> TexelCoverage:
    """Triangles (F, 3) with texture coordinates (V, 2), origin top-left, over a `size`² texture.

    Texture coordinates outside of [0, 1] cover nothing.
    """
    owner, weights, overlaps = rasterize_triangles(uvs.astype(np.float64)[faces] * size, size, size)
    texels = np.flatnonzero(owner >= 0)
    overlap = overlaps / (len(texels) + overlaps) if len(texels) else 0.0
    chosen = weights.reshape(-1, 3)[texels].astype(np.float64, copy=False)
    return TexelCoverage(size, texels, owner.reshape(-1)[texels], chosen, overlap)


def rasterize_triangles(
    corners: Array, height: int, width: int, single: bool = False, depths: Array | None = None
) -> tuple[Indices, NDArray[np.floating], int]:
    """The triangle (H, W) that covers each texel (−1: none), the barycentric weights (H, W, 3) of the texel's centre in
    it (not negative, sum 1), and the number of texels that lie inside more than one triangle.

    `corners` (F, 3, 2) are columns and rows in texels; centres of texels lie at .5. A texel is covered where its centre
    lies in the closed triangle, so that no texel is lost at a shared edge; of several triangles the last one is taken.
    Triangles without area and parts outside of the texture cover nothing. `single` stores the weights in float32.
    With `depths` (F, 3) of the corners, linear in the image, the triangle of least depth at the texel is taken.
    """
    owner = np.full(height * width, -1, dtype=np.int64)
    weights = np.zeros((height * width, 3), dtype=np.float32 if single else np.float64)
    claims = np.zeros(height * width, dtype=np.uint8)
    nearest = None if depths is None else np.full(height * width, np.inf)
    boxes = _boxes(corners, height, width)
    planes = _barycentric_planes(corners)
    counts = boxes[:, 2] * boxes[:, 3]
    counts[~np.isfinite(planes).all(axis=1)] = 0
    order = np.flatnonzero(counts)
    ends = np.cumsum(counts[order])
    start = 0
    while start < len(order):
        before = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, before + _CANDIDATES_PER_PASS, side="right")), start + 1)
        faces = order[start:stop]
        face, texel, inside = _inside(faces, counts[faces], boxes, planes, width)
        # a centre on a shared edge lies in two triangles of one chart, which is no overlap
        strict = texel[(inside[:, 0] > _STRICT) & (inside[:, 1] > _STRICT) & (inside[:, 2] > _STRICT)]
        twice, times = np.unique(strict, return_counts=True)
        claims[twice] = np.minimum(claims[twice] + np.minimum(times, 2), 2)
        if depths is not None and nearest is not None:
            depth = (inside * depths[face]).sum(axis=1)
            chosen = np.argsort(-depth, kind="stable")  # the nearest is written last
            chosen = chosen[depth[chosen] < nearest[texel[chosen]]]
            face, texel, inside = face[chosen], texel[chosen], inside[chosen]
            nearest[texel] = depth[chosen]
        owner[texel] = face
        weights[texel] = inside
        start = stop
    return owner.reshape(height, width), weights.reshape(height, width, 3), int((claims > 1).sum())


def _boxes(corners: Array, height: int, width: int) -> Indices:
    """(F, 4): first column and row of the texel centres in each triangle's box, and numbers of columns and rows."""
    limit = np.array([width, height])
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5 - _SLACK), 0, limit)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5 + _SLACK), -1, limit - 1)
    return np.concatenate([low, np.maximum(high - low + 1, 0)], axis=1).astype(np.int64)


def _barycentric_planes(corners: Array) -> Array:
    """(F, 6): second and third barycentric of a texel centre as `p + q·column + r·row`; not finite without area."""
    a, ab, ac = corners[:, 0] - 0.5, corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    area = np.where(np.abs(area) > 1e-12, area, np.nan)
    second_x, second_y = ac[:, 1] / area, -ac[:, 0] / area
    third_x, third_y = -ab[:, 1] / area, ab[:, 0] / area
    second = -(second_x * a[:, 0] + second_y * a[:, 1])
    third = -(third_x * a[:, 0] + third_y * a[:, 1])
    return np.stack([second, second_x, second_y, third, third_x, third_y], axis=1)


def _inside(
    faces: Indices,
    counts: Indices,
    boxes: Indices,
    planes: Array,
    width: int,
) -> tuple[Indices, Indices, Array]:
    """Face, texel and barycentrics (N, 3) of all texel centres in the boxes of `faces` that lie in the triangle."""
    local = np.repeat(np.arange(len(faces)), counts)
    offset = np.arange(len(local)) - np.repeat(np.cumsum(counts) - counts, counts)
    first_column, first_row, columns = boxes[faces, 0], boxes[faces, 1], boxes[faces, 2]
    down = offset // columns[local]
    column = offset - down * columns[local] + first_column[local]
    row = down + first_row[local]
    p = [planes[faces, i][local] for i in range(6)]
    second = p[0] + p[1] * column + p[2] * row
    third = p[3] + p[4] * column + p[5] * row
    first = 1 - second - third
    inside = np.flatnonzero((first >= -_SLACK) & (second >= -_SLACK) & (third >= -_SLACK))
    weights = np.clip(np.stack([first[inside], second[inside], third[inside]], axis=1), 0, 1)
    weights /= (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]
    return faces[local[inside]], row[inside] * width + column[inside], weights


def dilate(values: NDArray[np.float32], known: NDArray[np.bool_], steps: int) -> NDArray[np.float32]:
    """A texture (H, W, C) dilated into texels outside the mask `known` (H, W), one ring of texels in each step.

    A new texel is the mean of its known neighbours, of eight.
    """
    width = known.shape[1]
    padded = np.pad(np.where(known[..., None], values, 0), ((1, 1), (1, 1), (0, 0))).reshape(-1, values.shape[2])
    valid, inside = np.pad(known, 1).reshape(-1), np.pad(np.ones_like(known), 1).reshape(-1)
    row = width + 2
    offsets = (-row, row, -1, 1, -row - 1, -row + 1, row - 1, row + 1)
    added = [np.zeros(0, np.int64)]
    border = np.flatnonzero(valid & ~_all_neighbours(np.pad(known, 1, constant_values=True)))
    for _ in range(steps):
        # each texel of the next ring is beside one of the last ring
        beside = np.unique(np.concatenate([border + offset for offset in offsets]))
        border = beside[~valid[beside] & inside[beside]]
        if not len(border):
            break
        total, count = np.zeros((len(border), values.shape[2]), np.float32), np.zeros(len(border), np.float32)
        for offset in offsets:
            total += padded[border + offset]
            count += valid[border + offset]
        padded[border] = total / count[:, None]
        valid[border] = True
        added.append(border)
    result, new = values.copy(), np.concatenate(added)
    result.reshape(-1, values.shape[2])[(new // row - 1) * width + new % row - 1] = padded[new]
    return result


def _all_neighbours(padded: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether all eight neighbours of a texel are set, from a mask padded by one texel; padded again with False."""
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    result = np.ones((height, width), np.bool_)
    for y, x in ((0, 1), (2, 1), (1, 0), (1, 2), (0, 0), (0, 2), (2, 0), (2, 2)):
        result &= padded[y : y + height, x : x + width]
    return np.pad(result, 1).reshape(-1)
