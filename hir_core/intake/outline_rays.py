"""Rays through the outline of a mask: each is tangent to the object somewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera

_NORMAL_BLUR = 2.0
"""Standard deviation, in pixels, of the smoothing before the direction of the outline is read off the mask."""

_FRAME_MARGIN = 2
"""Pixels of the frame's border that are left out: there the frame cuts the object, not the outline."""


@dataclass(frozen=True, eq=False)
class OutlineRays:
    """Rays of one view, in the world."""

    origins: Array
    """(N, 3)."""
    directions: Array
    """(N, 3), of length 1."""
    normals: Array
    """(N, 3), of length 1, out of the object: those of its tangent planes that contain the rays."""


def outline_rays(camera: Camera, mask: NDArray[np.float32], limit: int, random: np.random.Generator) -> OutlineRays:
    """At most `limit` rays, drawn without replacement from the points of the 0.5 level of the mask (H, W)."""
    from scipy.ndimage import gaussian_filter, map_coordinates
    from skimage.measure import find_contours

    lines = find_contours(np.pad(mask, 1), 0.5)
    # contours have whole numbers at the centres of pixels, and here a border of one pixel
    found = np.concatenate(lines)[:, ::-1] - 0.5 if lines else np.zeros((0, 2))
    size = np.array([camera.width, camera.height])
    found = found[((found > _FRAME_MARGIN) & (found < size - _FRAME_MARGIN)).all(axis=1)]
    found = found[np.sort(random.permutation(len(found))[:limit])]
    smooth = gaussian_filter(mask, _NORMAL_BLUR)
    row, column = found[:, 1] - 0.5, found[:, 0] - 0.5

    def at(rows: Array, columns: Array) -> Array:
        return np.asarray(map_coordinates(smooth, [rows, columns], order=1, mode="nearest"))

    outward = np.stack([at(row, column - 1) - at(row, column + 1), at(row - 1, column) - at(row + 1, column)], axis=1)
    # the plane through the camera's centre and a line of the image (Hartley & Zisserman 2004, result 8.2)
    line = np.concatenate([outward, -(outward * found).sum(axis=1, keepdims=True)], axis=1)
    normal = line @ camera.intrinsics @ camera.world_to_camera[:3, :3]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    origins, directions = camera.rays(found)
    kept = length[:, 0] > 0
    return OutlineRays(origins[kept], directions[kept], normal[kept] / length[kept])
