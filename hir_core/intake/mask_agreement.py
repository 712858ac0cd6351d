"""Agreement of masks and cameras: each mask compared with the re-projected hull of all masks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera
from hir_core.intake.view_directions import camera_focus

if TYPE_CHECKING:
    pass


_GRID_RESOLUTION = 56

MAX_HULL_VIEWS = 300
"""The hull is made of at most so many masks, evenly spaced; each takes about 0.1 s."""


def mask_agreement(cameras: Sequence[Camera | None], masks: Sequence[NDArray[np.float32] | None]) -> list[float | None]:
    """Per view the IoU of its mask and the re-projected hull of all masks; None for views without mask or camera.

    The hull, on a coarse grid, consists of points that nine in ten masks agree on, so that a wrong mask lowers only its
    own value.
    """
    result: list[float | None] = [None] * len(cameras)
    pairs = {
        i: (camera, mask)
        for i, (camera, mask) in enumerate(zip(cameras, masks, strict=True))
        if camera is not None and mask is not None and mask.any()
    }
    if len(pairs) < 3:
        return result
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), MAX_HULL_VIEWS)).round().astype(int))
    listed = list(pairs.values())
    hull = _consensus_hull([listed[i] for i in chosen])
    for index, (camera, mask) in pairs.items():
        if hull is None:
            result[index] = 0.0
            continue
        points, cell = hull
        silhouette = _project_cells(points, cell, camera)
        solid = mask > 0.5
        result[index] = float((silhouette & solid).sum() / max((silhouette | solid).sum(), 1))
    return result


def _consensus_hull(pairs: Sequence[tuple[Camera, NDArray[np.float32]]]) -> tuple[Array, float] | None:
    """Grid points (N, 3) that are object in nine of ten masks, and the grid's spacing; None without such points."""
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
        points = grid[(mask_count >= 0.9 * image_count) & (image_count >= max(2.0, image_count.max() / 2))]
        if len(points) < 2:
            return None
        low, high = points.min(axis=0) - 1.5 * cell, points.max(axis=0) + 1.5 * cell
    return points, cell


def _project_cells(points: Array, cell: float, camera: Camera) -> NDArray[np.bool_]:
    """Pixels (H, W) whose centre is within half a cell of a projected point."""
    covered = np.zeros((camera.height, camera.width), dtype=bool)
    at, depth = camera.project(points)
    ahead = depth > 0
    at, half = at[ahead], 0.5 * cell * camera.intrinsics[0, 0] / depth[ahead]
    reach = int(np.ceil(half.max(initial=0.0)))
    x0, y0 = np.floor(at).astype(int).T
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            x, y = x0 + dx, y0 + dy
            near = (np.abs(x + 0.5 - at[:, 0]) <= half + 0.5) & (np.abs(y + 0.5 - at[:, 1]) <= half + 0.5)
            near &= (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
            covered[y[near], x[near]] = True
    return covered
