"""Depth maps: consistency between photographs, weights, and the oriented points that they give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import max_pool2d

from hir_core.capture import Array, Camera, OrientedPoints
from hir_plugins.initializers.stereo.surface_sweep import SweptView, pixel_to_pixel, reproject, texture_confidence

_FLAT_WINDOW_WEIGHT = 0.3
"""Weight of depths in windows without texture, which come from their surroundings."""

_MIN_WEIGHT = 0.05
"""Depths with a smaller weight are removed."""


@dataclass(frozen=True)
class DepthMap:
    """Depth along the optical axis of one photograph."""

    camera: Camera
    inverse: Tensor
    """(H, W), inverse depth, 0 where unknown."""
    weight: Tensor
    """(H, W), 0…1, 0 where `inverse` is 0."""

    def to(self, device: str) -> DepthMap:
        """The same map on another device."""
        return DepthMap(self.camera, self.inverse.to(device), self.weight.to(device))

    def points(self) -> tuple[Array, NDArray[np.int_], NDArray[np.int_]]:
        """World points (N, 3), with their rows and columns."""
        inverse = self.inverse.cpu().numpy().astype(np.float64)
        rows, columns = np.nonzero(inverse > 0)
        origins, directions = self.camera.rays(np.stack([columns, rows], axis=1) + 0.5)
        along = directions @ self.camera.world_to_camera[2, :3]
        return origins + directions / (along * inverse[rows, columns])[:, None], rows, columns


def consistent_depths(
    views: Sequence[SweptView],
    measured: Sequence[tuple[Tensor, Tensor]],
    neighbours: Sequence[Sequence[int]],
    steps: Sequence[float],
    window: int,
    min_views: int,
) -> list[DepthMap]:
    """Depths that at least `min_views` neighbours confirm within two steps, with weights.

    `measured` is the inverse depth and the correlation (H, W) of each view. Weights increase with the correlation and
    with the squared cosine between normal and ray. Windows across a depth edge are ignored: their background depths
    would be carved into the edge.
    """
    tolerance = 2 * float(np.median(steps))
    maps = []
    for i, (view, (inverse, score)) in enumerate(zip(views, measured, strict=True)):
        agreeing = torch.zeros_like(inverse)
        for j in neighbours[i]:
            agreeing += _confirms(view.camera, inverse, views[j].camera, measured[j][0], tolerance)
        flat = texture_confidence(view.image, window) < 0.5
        weight = torch.where(flat, torch.full_like(score, _FLAT_WINDOW_WEIGHT), ((score - 0.2) / 0.6).clamp(0, 1))
        weight = weight / (1 + _tangent_to_ray(view.inverse, view.camera) ** 2)
        accepted = (agreeing >= min_views) & (weight > _MIN_WEIGHT) & ~_crosses_depth_edge(view, window, 3 * steps[i])
        zero = torch.zeros_like(inverse)
        maps.append(DepthMap(view.camera, torch.where(accepted, inverse, zero), torch.where(accepted, weight, zero)))
    return maps


def oriented_points(
    maps: Sequence[DepthMap], images: Sequence[NDArray[np.float32]], spacing: float
) -> OrientedPoints | None:
    """One point per voxel of side `spacing` with depths: mean position, normal and linear colour.

    Normals are computed from the depth maps and face the cameras. None if there are no depths.
    """
    positions, normals, colors = [], [], []
    for depth_map, image in zip(maps, images, strict=True):
        points, rows, columns = depth_map.points()
        grid = np.full((*depth_map.inverse.shape, 3), np.nan)
        grid[rows, columns] = points
        along_x = np.full_like(grid, np.nan)
        along_y = np.full_like(grid, np.nan)
        along_x[:, 1:-1] = grid[:, 2:] - grid[:, :-2]
        along_y[1:-1] = grid[2:] - grid[:-2]
        # image y points down: the cross product of y and x faces the camera
        normal = np.cross(along_y, along_x)[rows, columns]
        length = np.linalg.norm(normal, axis=1)
        valid = np.isfinite(length) & (length > 0)
        normal = normal[valid] / length[valid, None]
        toward = depth_map.camera.center - points[valid]
        normal = np.where((normal * toward).sum(axis=1, keepdims=True) < 0, -normal, normal)
        positions.append(points[valid])
        normals.append(normal)
        colors.append(image[rows[valid], columns[valid]])
    if not positions or not sum(len(p) for p in positions):
        return None
    p, n, c = np.concatenate(positions), np.concatenate(normals), np.concatenate(colors).astype(np.float64)
    cells = np.floor((p - p.min(axis=0)) / spacing).astype(np.int64)
    _, group, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(group, values[:, i]) for i in range(3)], axis=1) / count[:, None]

    normal = mean(n)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    sound = length[:, 0] > 0.2
    return OrientedPoints(mean(p)[sound], (normal / np.maximum(length, 1e-12))[sound], mean(c)[sound])


def _confirms(camera: Camera, inverse: Tensor, other: Camera, theirs: Tensor, tolerance: float) -> Tensor:
    """1 where the other depth map contains the same surface point (H, W), else 0."""
    x, y, z = reproject(*pixel_to_pixel(camera, other), inverse)
    ahead = (inverse > 0) & (z > 1e-9)
    z = torch.where(ahead, z, torch.ones_like(z))
    column, row = (x / z).floor(), (y / z).floor()
    height, width = theirs.shape
    seen = ahead & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    at = theirs[row.clamp(0, height - 1).long(), column.clamp(0, width - 1).long()]
    # z is the depth in the other view divided by ours
    return (seen & (at > 0) & ((at - inverse / z).abs() < tolerance)).float()


def _tangent_to_ray(inverse: Tensor, camera: Camera) -> Tensor:
    """Tangent (H, W) of the angle between the surface's normal and the ray, from the gradient of depth."""
    depth = torch.where(inverse > 0, 1 / inverse.clamp_min(1e-9), torch.zeros_like(inverse))
    along_x, along_y = torch.zeros_like(depth), torch.zeros_like(depth)
    along_x[:, 1:-1] = (depth[:, 2:] - depth[:, :-2]) / 2
    along_y[1:-1] = (depth[2:] - depth[:-2]) / 2
    return torch.hypot(along_x, along_y) * camera.focal_length / depth.clamp_min(1e-6)


def _crosses_depth_edge(view: SweptView, window: int, jump: float) -> Tensor:
    """Where (H, W) a window contains points far behind its centre, or background."""
    object_inverse = torch.where(view.inside, view.inverse, torch.zeros_like(view.inverse))
    farthest = -max_pool2d(-object_inverse[None, None], window, 1, window // 2)[0, 0]
    return (farthest <= 0) | (object_inverse - farthest > jump * (window // 2))
