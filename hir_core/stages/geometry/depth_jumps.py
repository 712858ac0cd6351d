"""Depth jumps: where the depth of a mesh changes between neighbouring pixels by more than a slope explains."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from hir_core.capture import Camera
from hir_core.mesh.ray_casting import MeshQueries

FULL_RESOLUTION_PIXELS = 256
"""Depth is computed at every second pixel of larger photographs: it decides what a vertex sees, not where edges are."""

LEAST_JUMP_PIXELS = 3.0
"""In widths of a pixel at the surface. A smaller jump moves colours by little from one view to the next."""


def depth_map(
    tracer: MeshQueries, camera: Camera, mask: Bool[NDArray[np.bool_], "H W"], factor: int
) -> NDArray[np.float32]:
    """Distance of the mesh from the camera at pixels in or beside the mask (H, W), at 1/`factor` of its resolution;
    infinite elsewhere.
    """
    camera = camera.downsampled(factor)
    height, width = camera.height, camera.width
    depth = np.full((height, width), np.inf, np.float32)
    y, x = np.nonzero(binary_dilation(mask[::factor, ::factor][:height, :width], iterations=2))
    origins, directions = camera.rays(np.stack([x, y], axis=1) + 0.5)
    depth[y, x] = tracer.first_distances(origins.astype(np.float32), directions.astype(np.float32))
    return depth


def depth_factor(camera: Camera) -> int:
    """Pixels of the photograph for each pixel of its depth map."""
    return 2 if min(camera.width, camera.height) >= FULL_RESOLUTION_PIXELS else 1


def beside_jumps(
    depth: Float[NDArray[np.float32], "H W"],
    pixel_angle: float,
    margin: int,
    least_jump: float = LEAST_JUMP_PIXELS,
    outlines: bool = True,
) -> Bool[NDArray[np.bool_], "H W"]:
    """The pixels within `margin` (at least 1) of a jump and, with `outlines`, of the border of the mesh.

    `pixel_angle` is the width of a pixel at distance 1, `least_jump` the smallest jump in widths of a pixel.
    """
    finite = np.isfinite(depth)
    known = np.where(finite, depth, 0.0)
    beside = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        near, far = (np.take(known, range(a, depth.shape[axis] - 1 + a), axis) for a in (0, 1))
        hit_near, hit_far = (np.take(finite, range(a, depth.shape[axis] - 1 + a), axis) for a in (0, 1))
        jump = np.abs(near - far) > least_jump * pixel_angle * np.minimum(near, far)
        jump = (jump & hit_near & hit_far) | (outlines & (hit_near != hit_far))
        first = [slice(None), slice(None)]
        second = [slice(None), slice(None)]
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        beside[tuple(first)] |= jump
        beside[tuple(second)] |= jump
    return np.asarray(binary_dilation(beside, iterations=margin - 1) if margin > 1 else beside, dtype=bool)
