"""Where the object is in each photograph, as a reconstruction of points or a hull of rough masks tells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture
from hir_core.errors import CaptureError

_GRID_RESOLUTION = 72


def object_points(capture: Capture) -> tuple[Array, Array, float]:
    """Points (N, 3) of the capture that belong to what all photographs look at, its centre (3,) and radius.

    The object is taken to be the dense cloud around where the cameras' axes meet; points more than three times the
    median distance from there, or outside of most pictures, are the room's. Too few points raise `CaptureError`.
    """
    points = capture.points
    if points is None or len(points.positions) < 50:
        raise CaptureError(
            f"{capture.path}: masks by grabcut need the object's points; run colmap before, such as: "
            '--set \'initializers=["colmap", "visual_hull"]\''
        )
    cameras = capture.cameras
    inside = np.zeros(len(points.positions))
    for camera in cameras:
        pixels, depth = camera.project(points.positions)
        inside += (depth > 0) & (pixels >= 0).all(axis=1) & (pixels <= [camera.width, camera.height]).all(axis=1)
    near = points.positions[inside >= 0.6 * len(cameras)]
    if len(near) < 30:
        near = points.positions
    for _ in range(5):
        center = np.median(near, axis=0)
        distance = np.linalg.norm(near - center, axis=1)
        kept = near[distance <= 3 * np.median(distance)]
        if len(kept) == len(near):
            break
        near = kept
    center = np.median(near, axis=0)
    return near, center, float(np.quantile(np.linalg.norm(near - center, axis=1), 0.97))


def draw_discs(points: Array, camera: Camera, radius: float) -> NDArray[np.bool_]:
    """Pixels (H, W) within a world `radius` of some point, as seen by the camera."""
    import cv2

    picture = np.zeros((camera.height, camera.width), np.uint8)
    pixels, depth = camera.project(points)
    focal = float(np.sqrt(abs(np.linalg.det(camera.intrinsics[:2, :2]))))
    limit = max(camera.width, camera.height)
    for (x, y), z in zip(pixels, depth, strict=True):
        if z > 0 and abs(x) < 2 * limit and abs(y) < 2 * limit:
            cv2.circle(picture, (round(x), round(y)), max(1, round(radius * focal / z)), 255, -1)
    return picture > 0


def consistent_silhouettes(
    masks: Sequence[NDArray[np.bool_]], cameras: Sequence[Camera], center: Array, radius: float, agreement: float
) -> list[NDArray[np.bool_]]:
    """Each view's silhouette (H, W) of the places that look like the object in a share `agreement` of the views.

    A place must lie in at least half as many pictures as the best shown one. The largest connected body counts.
    """
    from scipy.ndimage import label

    axis = np.linspace(-radius, radius, _GRID_RESOLUTION)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + center
    shown, inside = np.zeros(len(grid)), np.zeros(len(grid))
    for mask, camera in zip(masks, cameras, strict=True):
        pixels, depth = camera.project(grid)
        columns, rows = np.floor(np.clip(pixels, -1e6, 1e6)).astype(int).T
        seen = (depth > 0) & (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
        shown += seen
        inside[seen] += mask[rows[seen], columns[seen]]
    solid = (inside >= agreement * shown) & (shown >= shown.max() / 2) & (shown > 0)
    bodies, count = label(solid.reshape([_GRID_RESOLUTION] * 3))
    if count == 0:
        return [np.zeros_like(mask) for mask in masks]
    largest = np.bincount(bodies.reshape(-1))[1:].argmax() + 1
    body = grid[bodies.reshape(-1) == largest]
    # a cell's half diagonal, so that neighbouring cells overlap in the picture
    reach = float(axis[1] - axis[0]) * np.sqrt(3) / 2
    return [draw_discs(body, camera, reach) for camera in cameras]
