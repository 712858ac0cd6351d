"""Agreement of masks and cameras: each mask compared with the re-projected hull of all masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera
from hir_core.intake.silhouette_gap import silhouette_gap
from hir_core.intake.view_directions import camera_focus

_GRID_RESOLUTION = 56

MAX_HULL_VIEWS = 300
"""The hull is made of at most so many masks, evenly spaced; each takes about 0.1 s."""


MIN_AGREEMENT = 0.7
"""Median IoU below which masks and cameras do not agree at all, such as those of other axes."""
MAX_BELOW_MEDIAN = 0.12
"""A view whose IoU is further below the median has a wrong mask, or a wrong camera."""


@dataclass(frozen=True)
class MaskAgreement:
    """Masks and cameras compared."""

    iou: tuple[float | None, ...]
    """Per view, of its mask and the re-projected hull of all masks; None for views without mask or camera."""
    gap: float | None
    """As `silhouette_gap`, of the views that do not stand out; None where nothing agrees, and for few masks."""


def mask_agreement(cameras: Sequence[Camera | None], masks: Sequence[NDArray[np.float32] | None]) -> MaskAgreement:
    """Each mask compared with the hull of the others.

    The hull for the IoU, on a coarse grid, consists of points that nine in ten masks agree on, so that a wrong mask
    lowers only its own value.
    """
    result: list[float | None] = [None] * len(cameras)
    pairs = {
        i: (camera, mask)
        for i, (camera, mask) in enumerate(zip(cameras, masks, strict=True))
        if camera is not None and mask is not None and mask.any()
    }
    if len(pairs) < 3:
        return MaskAgreement(tuple(result), None)
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), MAX_HULL_VIEWS)).round().astype(int))
    listed = list(pairs.values())
    hull = _consensus_hull([listed[i] for i in chosen])
    if hull is None:
        return MaskAgreement(tuple(0.0 if i in pairs else None for i in range(len(cameras))), None)
    points, cell = hull
    scores = []
    for camera, mask in listed:
        silhouette = _project_cells(points, cell, camera)
        solid = mask > 0.5
        scores.append(float((silhouette & solid).sum() / max((silhouette | solid).sum(), 1)))
    for index, score in zip(pairs, scores, strict=True):
        result[index] = score
    middle = float(np.median(scores))
    usual = [listed[i] for i in chosen if scores[i] >= middle - MAX_BELOW_MEDIAN]
    low, high = points.min(axis=0) - 1.5 * cell, points.max(axis=0) + 1.5 * cell
    gap = silhouette_gap(usual, low, high) if middle >= MIN_AGREEMENT else None
    return MaskAgreement(tuple(result), gap)


def _consensus_hull(pairs: Sequence[tuple[Camera, NDArray[np.float32]]]) -> tuple[Array, float] | None:
    """Grid points (N, 3) that are object in nine of ten masks, as far as they are at the boundary of all these, and the
    grid's spacing; None without such points."""
    focus, distance = camera_focus([c for c, _ in pairs])
    low, high = focus - 0.8 * distance, focus + 0.8 * distance
    points, cell = np.zeros((0, 3)), 0.0
    for _ in range(3):  # refine the grid around the remaining points
        axes = [np.linspace(low[i], high[i], _GRID_RESOLUTION) for i in range(3)]
        cell = float(max(a[1] - a[0] for a in axes))
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        image_count, mask_count = np.zeros(len(grid)), np.zeros(len(grid))
        for camera, mask in pairs:
            at, depth = camera.project(grid)
            x, y = np.floor(np.clip(at, -1, 1e6)).astype(int).T
            seen = (depth > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
            image_count += seen
            mask_count[seen] += mask[y[seen], x[seen]] > 0.5
        inside = (mask_count >= 0.9 * image_count) & (image_count >= max(2.0, image_count.max() / 2))
        points = grid[inside]
        if len(points) < 2:
            return None
        low, high = points.min(axis=0) - 1.5 * cell, points.max(axis=0) + 1.5 * cell
    return grid[_boundary(inside.reshape((_GRID_RESOLUTION,) * 3)).reshape(-1)], cell


def _boundary(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells of a solid with a neighbour outside: the silhouette is theirs."""
    padded = np.pad(inside, 1)
    core = inside.copy()
    for axis in range(3):
        for shift in (-1, 1):
            core &= np.roll(padded, shift, axis)[1:-1, 1:-1, 1:-1]
    return inside & ~core


def _project_cells(points: Array, cell: float, camera: Camera) -> NDArray[np.bool_]:
    """Pixels (H, W) whose square is within half a cell of a projected point, in x and in y.

    Each point adds a rectangle of pixels. The corners of all rectangles are summed up first, and the sum over rows and
    columns then counts the rectangles at each pixel (a summed-area table; Crow 1984).
    """
    height, width = camera.height, camera.width
    at, depth = camera.project(points)
    ahead = depth > 0
    at, half = at[ahead], (0.5 * cell * camera.intrinsics[0, 0] / depth[ahead])[:, None]
    size = np.array([width, height])
    first = np.clip(np.ceil(at - half - 1), 0, size).astype(int)
    end = np.clip(np.floor(at + half) + 1, 0, size).astype(int)
    first = np.minimum(first, end)
    corners = np.zeros((height + 1) * (width + 1))
    for x, y, sign in ((first, first, 1), (end, first, -1), (first, end, -1), (end, end, 1)):
        corners += sign * np.bincount(y[:, 1] * (width + 1) + x[:, 0], minlength=len(corners))
    count = corners.reshape(height + 1, width + 1).cumsum(axis=0).cumsum(axis=1)
    return count[:height, :width] > 0.5
