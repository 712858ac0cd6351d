"""Keeps the depths that photographs agree on, and fuses them to oriented points and to a volume."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, OrientedPoints
from hir_plugins.initializers.carving import Volume
from hir_plugins.initializers.depth_maps import DepthMap


def consistent(
    maps: Sequence[DepthMap], neighbours: Sequence[Sequence[int]], min_score: float, min_views: int, max_pixels: float
) -> list[DepthMap]:
    """The maps with only those depths that `min_views` neighbours confirm.

    A neighbour confirms a depth when its own depth at that place, carried back, lies within `max_pixels` of the pixel
    and within the depth that `max_pixels` of parallax between the two make.
    """
    kept = []
    for index, reference in enumerate(maps):
        points, rows, columns = back_project(reference, min_score)
        votes = np.zeros(len(points), dtype=int)
        for j in neighbours[index]:
            other = maps[j]
            pixels, _ = other.camera.project(points)
            height, width = other.depth.shape
            x, y = np.floor(np.clip(pixels, -1, 1e6)).astype(int).T
            seen = (x >= 0) & (y >= 0) & (x < width) & (y < height)
            depth = np.zeros(len(points), dtype=np.float32)
            depth[seen] = other.depth[y[seen], x[seen]]
            has = depth > 0
            landed = _at_depth(other, pixels[has], depth[has])
            back, back_depth = reference.camera.project(landed)
            offset = np.linalg.norm(back - np.stack([columns[has], rows[has]], axis=1) - 0.5, axis=1)
            own = reference.depth[rows[has], columns[has]]
            # the change of depth that moves the match by a pixel at this baseline
            baseline = float(np.linalg.norm(other.camera.center - reference.camera.center))
            tolerance = max_pixels * own**2 / (reference.camera.intrinsics[0, 0] * max(baseline, 1e-12))
            good = (offset < max_pixels) & (np.abs(back_depth - own) < tolerance)
            votes[np.nonzero(has)[0][good]] += 1
        left = np.zeros_like(reference.depth)
        confirmed = votes >= min_views
        left[rows[confirmed], columns[confirmed]] = reference.depth[rows[confirmed], columns[confirmed]]
        kept.append(DepthMap(reference.camera, left, reference.score))
    return kept


def back_project(depth_map: DepthMap, min_score: float = -1.0) -> tuple[Array, NDArray[np.int_], NDArray[np.int_]]:
    """World points (N, 3) of a map's depths, with their rows and columns."""
    rows, columns = np.nonzero((depth_map.depth > 0) & (depth_map.score >= min_score))
    pixels = np.stack([columns, rows], axis=1) + 0.5
    return _at_depth(depth_map, pixels, depth_map.depth[rows, columns]), rows, columns


def _at_depth(depth_map: DepthMap, pixels: Array, depth: Array) -> Array:
    origins, directions = depth_map.camera.rays(pixels)
    along = directions @ depth_map.camera.world_to_camera[2, :3]
    return origins + directions * (depth / along)[:, None]


def oriented_points(
    maps: Sequence[DepthMap], images: Sequence[NDArray[np.float32]], spacing: float
) -> OrientedPoints | None:
    """One point for each cube of side `spacing` that holds depths: means of places, normals and linear colours.

    Normals come from the depth maps' own slopes and face the cameras. None where there are no depths.
    """
    places, normals, colors = [], [], []
    for depth_map, image in zip(maps, images, strict=True):
        points, rows, columns = back_project(depth_map)
        grid = np.full((*depth_map.depth.shape, 3), np.nan)
        grid[rows, columns] = points
        along_x = np.full_like(grid, np.nan)
        along_y = np.full_like(grid, np.nan)
        along_x[:, 1:-1] = grid[:, 2:] - grid[:, :-2]
        along_y[1:-1] = grid[2:] - grid[:-2]
        # image y runs down: x across y looks away from the camera, so y across x faces it
        normal = np.cross(along_y, along_x)[rows, columns]
        length = np.linalg.norm(normal, axis=1)
        good = np.isfinite(length) & (length > 0)
        normal = normal[good] / length[good, None]
        toward = depth_map.camera.center - points[good]
        normal = np.where((normal * toward).sum(axis=1, keepdims=True) < 0, -normal, normal)
        places.append(points[good])
        normals.append(normal)
        colors.append(image[rows[good], columns[good]])
    if not places or not sum(len(p) for p in places):
        return None
    p, n, c = np.concatenate(places), np.concatenate(normals), np.concatenate(colors).astype(np.float64)
    cells = np.floor((p - p.min(axis=0)) / spacing).astype(np.int64)
    _, group, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(group, values[:, i]) for i in range(3)], axis=1) / count[:, None]

    normal = mean(n)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    sound = length[:, 0] > 0.2
    return OrientedPoints(mean(p)[sound], (normal / np.maximum(length, 1e-12))[sound], mean(c)[sound])


def fuse_into(
    volume: Volume, maps: Sequence[DepthMap], reach: float, min_weight: float, doubt: float
) -> Volume:
    """The hull with what stereo carves out of it (Curless & Levoy 1996): never larger than the hull.

    `volume` is positive inside. Samples with fewer than `min_weight` depths, in front of the measured surface or at
    most `reach` behind it, keep the hull's value. Stereo carves only what lies `doubt` in front of what it measured:
    the least of hull and noise would be too thin. Distances are cut off at one and a half voxels on both sides, so that
    far off depths are votes and a few wrong ones do not outweigh the right ones.
    """
    truncation = 1.5 * volume.spacing
    size = volume.values.shape
    near = np.nonzero(volume.values.reshape(-1) > -2 * volume.spacing)[0]
    index = np.stack(np.unravel_index(near, size), axis=1)
    points = volume.origin + index * volume.spacing
    total, weight = np.zeros(len(points)), np.zeros(len(points))
    for depth_map in maps:
        pixels, depth = depth_map.camera.project(points)
        height, width = depth_map.depth.shape
        x, y = np.floor(np.clip(pixels, -1, 1e6)).astype(int).T
        seen = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        measured = np.zeros(len(points))
        measured[seen] = depth_map.depth[y[seen], x[seen]]
        # positive behind the measured surface: inside the object
        signed = depth - measured
        counted = seen & (measured > 0) & (signed < reach)
        total[counted] += np.clip(signed[counted] + doubt, -truncation, truncation)
        weight[counted] += 1
    known = weight >= min_weight
    mean = total[known] / weight[known]
    values = volume.values.reshape(-1).copy()
    values[near[known]] = np.minimum(values[near[known]], mean)
    return Volume(values.reshape(size).astype(np.float32), volume.origin, volume.spacing)
