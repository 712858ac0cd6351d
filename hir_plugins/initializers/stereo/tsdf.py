"""A surface from depth maps: truncated signed distances averaged in voxels (Curless & Levoy 1996), by open3d."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import open3d
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_core.errors import StageError
from hir_plugins.initializers.stereo.depth_consistency import DepthMap

_TRUNCATION_VOXELS = 4.0
"""Truncation of distances, in voxels."""


def tsdf_surface(maps: Sequence[DepthMap], voxel: float) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3) of the fused depths; open where nothing was measured.

    `voxel` is the side of a voxel in world units. Raises `StageError` if the depths give no surface.
    """
    # open3d hashes blocks by integer coordinates near the origin: fuse in units of voxels, around the points' median
    measured = [m for m in maps if bool((m.inverse > 0).any())]
    mesh = None
    if measured:
        middle = np.median(np.concatenate([m.points()[0] for m in measured]), axis=0)
        mesh = _fused([_in_voxels(m, middle, voxel) for m in measured])
    if mesh is None or len(mesh.triangle.indices) == 0:
        raise StageError('the measured depths give no surface; use initializer.stereo.surface="auto"')
    positions = mesh.vertex.positions.numpy().astype(np.float64) * voxel + middle
    return positions, mesh.triangle.indices.numpy().astype(np.int64)


def _in_voxels(depth_map: DepthMap, middle: Array, voxel: float) -> tuple[Array, Array, Array]:
    """Depth (H, W) in voxels, 0 where unknown, intrinsics (3, 3) and pose (4, 4) in open3d's conventions."""
    inverse = depth_map.inverse.cpu().numpy().astype(np.float64)
    depth = np.where(inverse > 0, 1 / np.maximum(inverse, 1e-30), 0) / voxel
    intrinsics, pose = depth_map.camera.intrinsics.copy(), depth_map.camera.world_to_camera.copy()
    # open3d has integer coordinates at pixel centres
    intrinsics[:2, 2] -= 0.5
    pose[:3, 3] = (pose[:3, :3] @ middle + pose[:3, 3]) / voxel
    return depth, intrinsics, pose


def _fused(maps: Sequence[tuple[Array, Array, Array]]) -> open3d.t.geometry.TriangleMesh:
    core: Any = open3d.core
    kinds, one = (core.float32, core.float32), core.SizeVector([1])
    grid = open3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), kinds, (one, one), 1.0, 16, 1000)
    for depth, intrinsics, pose in maps:
        picture = open3d.t.geometry.Image(depth[..., None].astype(np.float32))
        lens, extrinsics = core.Tensor(intrinsics, core.float64), core.Tensor(pose, core.float64)
        far = float(depth.max()) + 1
        blocks = grid.compute_unique_block_coordinates(picture, lens, extrinsics, 1.0, far, _TRUNCATION_VOXELS)
        grid.integrate(blocks, picture, lens, extrinsics, 1.0, far, _TRUNCATION_VOXELS)
    return grid.extract_triangle_mesh(weight_threshold=0.5)
