"""The object's region in each photograph, from reconstructed points or from a hull of rough masks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture
from hir_core.errors import CaptureError

_GRID_RESOLUTION = 72

MIN_POINTS = 50
"""Points from which the region of the object can be told."""


def object_points(capture: Capture) -> tuple[Array, Array, float]:
    """Points (N, 3) of the object, its centre (3,) and radius.

    Points outside most photographs, or farther from the centre than three times the median distance, are background.
    Too few points raise `CaptureError`.
    """
    points = capture.points
    count = 0 if points is None else len(points.positions)
    if points is None or count < MIN_POINTS:
        raise CaptureError(
            f"{capture.path}: the mask source grabcut needs {MIN_POINTS} reconstructed points, and there are {count}"
            f"{_without_mask(capture)}; put masks of the photographs into a folder 'masks', or name a source that "
            "needs no points, such as: --set 'masks=[\"rembg\"]'"
        )
    cameras = capture.cameras
    mask_count = np.zeros(len(points.positions))
    for camera in cameras:
        pixels, depth = camera.project(points.positions)
        mask_count += (depth > 0) & (pixels >= 0).all(axis=1) & (pixels <= [camera.width, camera.height]).all(axis=1)
    near = points.positions[mask_count >= 0.6 * len(cameras)]
    if len(near) < 30:
        near = points.positions
    for _ in range(5):
        center = np.median(near, axis=0)
        distance = np.linalg.norm(near - center, axis=1)
        inliers = near[distance <= 3 * np.median(distance)]
        if len(inliers) == len(near):
            break
        near = inliers
    center = np.median(near, axis=0)
    return near, center, float(np.quantile(np.linalg.norm(near - center, axis=1), 0.97))


def _without_mask(capture: Capture) -> str:
    """Which photographs have no mask, in parentheses; nothing where all have one."""
    bare = [view.name for view in capture.views if view.pixels().mask is None]
    return f" ({len(bare)} of {len(capture.views)} photographs have no mask, such as {bare[0]})" if bare else ""


def draw_discs(points: Array, camera: Camera, radius: float) -> NDArray[np.bool_]:
    """Pixels (H, W) within a world `radius` of the projection of any point."""
    import cv2

    picture = np.zeros((camera.height, camera.width), np.uint8)
    pixels, depth = camera.project(points)
    near = (depth > 0) & (np.abs(pixels) < 2 * max(camera.width, camera.height)).all(axis=1)
    radii = np.maximum(1, np.rint(radius * camera.focal_length / depth[near])).astype(int)
    discs = np.column_stack([np.rint(pixels[near]).astype(int), radii])
    for x, y, size in np.unique(discs, axis=0).tolist():
        cv2.circle(picture, (x, y), size, 255, -1)
    return picture > 0


def consistent_points(
    masks: Sequence[NDArray[np.bool_]], cameras: Sequence[Camera], center: Array, radius: float, agreement: float
) -> tuple[Array, float]:
    """Grid points (N, 3) that are object in a share `agreement` of the masks, and the radius of discs that join them.

    A point must be inside at least half of the largest number of images of any point. Only the largest connected
    component is used, and of that the points at its surface: the others are behind them in every view. No point where
    the masks do not agree.
    """
    from scipy.ndimage import binary_erosion, label

    axis = np.linspace(-radius, radius, _GRID_RESOLUTION)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + center
    view_count, mask_count = np.zeros(len(grid)), np.zeros(len(grid))
    for mask, camera in zip(masks, cameras, strict=True):
        pixels, depth = camera.project(grid)
        columns, rows = np.floor(np.clip(pixels, -1e6, 1e6)).astype(int).T
        seen = (depth > 0) & (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
        view_count += seen
        mask_count[seen] += mask[rows[seen], columns[seen]]
    solid = (mask_count >= agreement * view_count) & (view_count >= view_count.max() / 2) & (view_count > 0)
    # half a cell's diagonal, so that the discs of neighbouring cells overlap in the image
    reach = float(axis[1] - axis[0]) * np.sqrt(3) / 2
    components, count = label(solid.reshape([_GRID_RESOLUTION] * 3))
    if count == 0:
        return np.zeros((0, 3)), reach
    largest = components == np.bincount(components.reshape(-1))[1:].argmax() + 1
    surface = largest & ~binary_erosion(largest)
    return grid[surface.reshape(-1)], reach
