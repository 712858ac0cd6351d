"""Carves depth maps out of a volume, and verifies the carving by photo-consistency."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom
from torch import Tensor

from hir_plugins.initializers.stereo.depth_consistency import DepthMap
from hir_plugins.initializers.stereo.surface_sweep import SweptView, correlations, texture_confidence
from hir_plugins.initializers.surface.volume import Volume

_TRUNCATION_VOXELS = 2.0
"""Truncation of distances on both sides, in voxels: it limits the influence of single wrong depths."""

_MAX_DEPTH_BEHIND_VOXELS = 6.0
"""Distance behind a measured surface, in voxels, up to which the measurement is evidence of the inside."""

_SMOOTHING_VOXELS = 1.2
"""Standard deviation, in voxels, of the smoothing of carved distances; the noise of depths would make handles."""

_CARVED_VOXELS = 0.3
"""A distance that decreased by more than this many voxels was carved."""

_CARVED_SHARE = 0.02
"""Share of carved voxels around a voxel, by the same Gaussian, from which it is smoothed."""

_MIN_CORRELATION_GAIN = 0.02
"""Gain in correlation at which half of a carving is kept."""


def carve_depths(
    volume: Volume,
    maps: Iterable[DepthMap],
    min_weight: float,
    noise: float = 0.0,
    behind: float = _MAX_DEPTH_BEHIND_VOXELS,
) -> Volume:
    """The volume carved by depth maps (Curless & Levoy 1996), of which one at a time is needed; no value increases.

    Voxels keep their value where the total weight of the depths that pass in front of them or end near them is below
    `min_weight`. `noise` is the standard deviation of depths in world units; where it is larger than a voxel, distances
    are truncated in multiples of it, because errors on one side alone would move the surface. `behind` is the distance
    behind a depth, in voxels or standard deviations, up to which it is evidence of the inside.
    """
    spacing, size = volume.spacing, volume.values.shape
    unit = max(spacing, noise)
    remaining = iter(maps)
    first = next(remaining, None)
    if first is None:
        return volume
    device = first.inverse.device
    values = torch.from_numpy(volume.values).reshape(-1).to(device)
    near = torch.nonzero(values > -2 * spacing)[:, 0]
    # components in arrays of their own: torch is slow along a dimension of three
    index = torch.stack([near // (size[1] * size[2]), near // size[2] % size[1], near % size[2]]).float()
    total, weight = torch.zeros(len(near), device=device), torch.zeros(len(near), device=device)
    for depth_map in chain([first], remaining):
        projection = depth_map.camera.intrinsics @ depth_map.camera.world_to_camera[:3]
        rotation = torch.from_numpy(projection[:, :3] * spacing).float().to(device)
        translation = torch.from_numpy(projection[:, :3] @ volume.origin + projection[:, 3]).float().to(device)
        x, y, z = torch.addmm(translation[:, None], rotation, index)
        depth = z.clamp_min(1e-9)
        column, row = (x / depth).floor(), (y / depth).floor()
        height, width = depth_map.inverse.shape
        visible = torch.nonzero((z > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height))[:, 0]
        pixel = row.index_select(0, visible).long() * width + column.index_select(0, visible).long()
        inverse = depth_map.inverse.reshape(-1).index_select(0, pixel)
        # positive behind the measured surface: inside the object
        signed = z.index_select(0, visible) - 1 / inverse.clamp_min(1e-12)
        counted = torch.nonzero((inverse > 0) & (signed < behind * unit))[:, 0]
        visible, signed, pixel = (each.index_select(0, counted) for each in (visible, signed, pixel))
        confidence = depth_map.weight.reshape(-1).index_select(0, pixel)
        signed = signed.clamp(-_TRUNCATION_VOXELS * unit, _TRUNCATION_VOXELS * unit)
        total.index_add_(0, visible, signed * confidence)
        weight.index_add_(0, visible, confidence)
    known = weight >= min_weight
    values = values.clone()
    values[near[known]] = torch.minimum(values[near[known]], total[known] / weight[known])
    return replace(volume, values=values.reshape(size).cpu().numpy())


def smoothed_carving(whole: Volume, carving: Volume) -> Volume:
    """The carving with smoothed distances where depths carved; other voxels keep theirs, and nothing is added."""
    limit = _TRUNCATION_VOXELS * whole.spacing
    before, after = np.clip(whole.values, -limit, limit), np.clip(carving.values, -limit, limit)
    carved = (before - after > _CARVED_VOXELS * whole.spacing).astype(np.float32)
    near = gaussian_filter(carved, _SMOOTHING_VOXELS) > _CARVED_SHARE
    values = np.where(near, gaussian_filter(after, _SMOOTHING_VOXELS), carving.values)
    return replace(carving, values=np.minimum(whole.values, values))


@dataclass(frozen=True)
class VerifiedCarving:
    """The part of a carving that photo-consistency confirms."""

    volume: Volume
    removed: float
    """Share of the inside that was carved away."""
    confirmed: float
    """Share of the carved part that is confirmed."""
    gain: float
    """Median gain in correlation over the carved part."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing of the volume is carved away."""
        return self.removed * self.confirmed == 0


def verify_carving(
    whole: Volume,
    carving: Volume,
    views: Sequence[SweptView],
    neighbours: Sequence[Sequence[int]],
    window: int,
    steps: Sequence[float],
    allowed: NDArray[np.float32] | None = None,
) -> VerifiedCarving:
    """The carving where the photographs match better along the carved surface than along that of the whole volume.

    `views` contain the carved surface (`inverse`) and the whole one (`bound`). The difference of correlations at a
    pixel is accumulated in all cells between the two surfaces and smoothed over a few voxels, or over more where there
    is no data. A highlight, which matches at the depth of its mirror image behind the surface, is thus outweighed by
    photographs that show the same point without it. `allowed` (X, Y, Z) limits the share of the carving that is kept.
    """
    size = tuple(-(-n // 2) for n in whole.values.shape)
    gain, weight = np.zeros(int(np.prod(size))), np.zeros(int(np.prod(size)))
    for i, view in enumerate(views):
        if not neighbours[i]:
            continue
        carved_pixels = view.valid & (view.inverse > 0) & (view.bound - view.inverse > 0.75 * steps[i])
        if not carved_pixels.any():
            continue
        both = correlations(view, [views[j] for j in neighbours[i]], torch.stack([view.bound, view.inverse]), window)
        confidence = texture_confidence(view.image, window)
        rows, columns = torch.nonzero(carved_pixels & (confidence > 0.5), as_tuple=True)
        difference = (both[1] - both[0])[rows, columns].cpu().numpy()
        share = confidence[rows, columns].cpu().numpy()
        for cells in _cells_between_surfaces(view, rows, columns, whole, size):
            gain += np.bincount(cells, difference * share, minlength=len(gain))
            weight += np.bincount(cells, share, minlength=len(gain))
    smoothed = _smoothed_gain(gain.reshape(size), weight.reshape(size))
    fine = zoom(smoothed, 2, order=1, grid_mode=True, mode="nearest")[tuple(slice(n) for n in whole.values.shape)]
    # a smooth transition avoids steps in the surface
    switch = np.clip(0.5 + (fine - _MIN_CORRELATION_GAIN) / _MIN_CORRELATION_GAIN, 0, 1).astype(np.float32)
    if allowed is not None:
        switch *= allowed
    values = whole.values + switch * (carving.values - whole.values)
    removed = (whole.values > 0) & (carving.values <= 0)
    return VerifiedCarving(
        replace(whole, values=values),
        removed=float(removed.sum() / max((whole.values > 0).sum(), 1)),
        confirmed=float((removed & (values <= 0)).sum() / max(removed.sum(), 1)),
        gain=float(np.median(fine[removed])) if removed.any() else 0.0,
    )


def _cells_between_surfaces(
    view: SweptView, rows: Tensor, columns: Tensor, volume: Volume, size: tuple[int, ...]
) -> list[NDArray[np.int64]]:
    """Cells of two voxels' side, as flat indices, at eight points between the two surfaces of each pixel."""
    pixels = torch.stack([columns, rows], dim=1).cpu().numpy() + 0.5
    origins, directions = view.camera.rays(pixels)
    along = directions @ view.camera.world_to_camera[2, :3]
    front, back = (1 / m[rows, columns].cpu().numpy().astype(np.float64) for m in (view.bound, view.inverse))
    indices = []
    for share in np.linspace(0, 1, 8):
        points = origins + directions * ((front + share * (back - front)) / along)[:, None]
        cell = np.floor((points - volume.origin) / (2 * volume.spacing) + 0.25).astype(np.int64)
        indices.append(np.ravel_multi_index(tuple(np.clip(cell, 0, np.array(size) - 1).T), size))
    return indices


def _smoothed_gain(gain: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted mean of the gain around each cell; -1 where there is no data within reach."""
    result = np.full(gain.shape, -1.0)
    for sigma, least in ((6.0, 1e-6), (2.0, 1e-3)):
        sums, weights = gaussian_filter(gain, sigma), gaussian_filter(weight, sigma)
        result = np.where(weights > least, sums / np.maximum(weights, 1e-12), result)
    return result
