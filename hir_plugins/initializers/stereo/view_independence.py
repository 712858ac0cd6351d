"""Whether a carved surface explains the photographs from directions that lie far apart.

A reflection of the surroundings agrees between neighbouring photographs as a texture does: it is the picture of a
virtual surface behind the mirror, and carving follows it. From directions 35° to 60° apart that picture has changed on
most shapes, and the virtual surface leaves parts of the masks uncovered. So the brightness of a carved region is
correlated between distant photographs. The square of the correlation is the share of the variance that belongs to the
points of the surface; a pixel of the mask that the carving uncovers counts as one that nothing explains. A carving is
kept where it explains more than half.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, label
from torch import Tensor
from torch.nn.functional import grid_sample

from hir_core.capture import Array, Camera
from hir_plugins.initializers.stereo.stereo_photographs import directions_from, same_take
from hir_plugins.initializers.stereo.surface_sweep import SweptView, pixel_to_pixel, reproject
from hir_plugins.initializers.surface.volume import Volume

LEAST_ANGLE_DEG, MOST_ANGLE_DEG = 35.0, 60.0
"""Between the compared photographs: nearer ones show a reflection at nearly the same place, farther ones see little in
common."""

MAX_PAIRS_PER_VIEW = 8

LEAST_PIXELS = 30
"""Of a region in a pair of photographs; a correlation of fewer says nothing."""

HALF_OF_VARIANCE = 0.5
TRANSITION = 0.1
"""The kept share of a carving grows from 0 to 1 within this distance of `HALF_OF_VARIANCE`."""

_MIN_DEPTH_CHANGE_STEPS = 0.75
"""Inverse depth between both surfaces, in steps, from which a pixel was carved."""

_DEPTH_TOLERANCE_STEPS = 3.0
"""Within which the other photograph sees the same point."""


@dataclass(frozen=True)
class ViewIndependence:
    """How far carved regions explain distant photographs."""

    share: NDArray[np.float32]
    """(X, Y, Z) of the volume: which share of the carving is kept, 0 to 1."""
    explained: float | None
    """Share of the variance of brightness that all carved regions together explain; None where nothing was carved, or
    no two photographs are far enough apart."""


def view_independence(
    whole: Volume,
    carving: Volume,
    views: Sequence[SweptView],
    steps: Sequence[float],
    center: Array,
    takes: Sequence[int] = (),
) -> ViewIndependence:
    """The share of each connected carved region that is kept, on the grid of the volume.

    `views` contain the carved surface (`inverse`) and the whole one (`bound`). Photographs are compared within their
    take, of which `takes` has the numbers. Without two of one take between 35° and 60° apart nothing can be compared:
    everything is kept, with a warning. A region that too few pixels show follows the mean of all; where that is so of
    all regions nothing is kept.
    """
    removed = (whole.values > 0) & (carving.values <= 0)
    regions, count = label(binary_dilation(removed))
    pairs = _distant_pairs([view.camera for view in views], center, takes)
    if count and not pairs:
        warnings.warn(_no_distant_photographs(several_takes=len(set(takes)) > 1), stacklevel=2)
    if not count or not pairs:
        return ViewIndependence(np.ones(whole.values.shape, np.float32), None)
    nearest = distance_transform_edt(regions == 0, return_distances=False, return_indices=True)
    regions = regions[tuple(nearest)]
    seen, uncovered = np.zeros(count + 1), np.zeros(count + 1)
    labels = []
    for view, step in zip(views, steps, strict=True):
        carved, missed = _regions_of_pixels(view, step, whole, regions)
        seen += np.bincount(carved[carved > 0], minlength=count + 1)
        uncovered += np.bincount(missed, minlength=count + 1)
        labels.append(carved)
    sums, weights = np.zeros(count + 1), np.zeros(count + 1)
    for i, j in pairs:
        other, visible = _other_brightness(views[i], views[j], steps[i])
        for region in np.unique(labels[i][visible.cpu().numpy()]):
            chosen = visible & torch.from_numpy(labels[i] == region).to(visible.device)
            pixels = int(chosen.sum())
            if region and pixels >= LEAST_PIXELS:
                correlation = _correlation(views[i].image[chosen], other[chosen])
                sums[region] += pixels * max(correlation, 0.0) ** 2
                weights[region] += pixels
    covered = seen / np.maximum(seen + uncovered, 1)
    overall = float(sums.sum() / max(weights.sum(), 1)) * float(seen.sum() / max(seen.sum() + uncovered.sum(), 1))
    explained = np.where(weights > 0, covered * sums / np.maximum(weights, 1), overall)
    kept = np.clip((explained - HALF_OF_VARIANCE) / (2 * TRANSITION) + 0.5, 0, 1).astype(np.float32)
    return ViewIndependence(kept[regions], overall)


def _no_distant_photographs(several_takes: bool) -> str:
    photographs = "photographs of one take" if several_takes else "photographs"
    return (
        f"stereo: no two {photographs} are {LEAST_ANGLE_DEG:.0f}° to {MOST_ANGLE_DEG:.0f}° apart, so reflections "
        "cannot be told from texture; if the object is metal, leave stereo out: "
        "--set 'initializers=[\"visual_hull\"]'"
    )


def _distant_pairs(cameras: Sequence[Camera], center: Array, takes: Sequence[int]) -> list[tuple[int, int]]:
    toward = directions_from(cameras, center)
    angle = np.degrees(np.arccos(np.clip(toward @ toward.T, -1, 1)))
    if len(takes):
        angle[~same_take(takes)] = np.inf
    pairs = []
    for i, row in enumerate(angle):
        distant = np.flatnonzero((row > LEAST_ANGLE_DEG) & (row < MOST_ANGLE_DEG))
        # evenly over the angles, so that no direction is preferred
        chosen = distant[np.argsort(row[distant], kind="stable")]
        every = max(1, -(-len(chosen) // MAX_PAIRS_PER_VIEW))
        pairs += [(i, int(j)) for j in chosen[::every]]
    return pairs


def _regions_of_pixels(
    view: SweptView, step: float, volume: Volume, regions: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The region (H, W) between both surfaces at each carved pixel, 0 elsewhere; and the regions (N,) of the pixels of
    the mask that the carving uncovered.
    """
    found = np.zeros(tuple(view.image.shape), np.int32)
    carved = view.valid & (view.inverse > 0) & (view.bound - view.inverse > _MIN_DEPTH_CHANGE_STEPS * step)
    missed = view.inside & (view.bound > 0) & (view.inverse <= 0)
    middle = 0.5 / view.bound.clamp_min(1e-12) + 0.5 / view.inverse.clamp_min(1e-12)
    found[carved.cpu().numpy()] = _regions_at(view, carved, middle, volume, regions)
    return found, _regions_at(view, missed, 1 / view.bound.clamp_min(1e-12), volume, regions)


def _regions_at(
    view: SweptView, pixels: Tensor, depth: Tensor, volume: Volume, regions: NDArray[np.int32]
) -> NDArray[np.int32]:
    """The region nearest to the points at `depth` (H, W) of the chosen pixels."""
    rows, columns = torch.nonzero(pixels, as_tuple=True)
    origins, directions = view.camera.rays(torch.stack([columns, rows], dim=1).cpu().numpy() + 0.5)
    along = directions @ view.camera.world_to_camera[2, :3]
    points = origins + directions * (depth[rows, columns].cpu().numpy().astype(np.float64) / along)[:, None]
    cell = np.rint((points - volume.origin) / volume.spacing).astype(np.int64)
    return regions[tuple(np.clip(cell, 0, np.array(regions.shape) - 1).T)]


def _other_brightness(view: SweptView, other: SweptView, step: float) -> tuple[Tensor, Tensor]:
    """Brightness of the other photograph at the carved surface (H, W), and where it sees the same point."""
    x, y, z = reproject(*pixel_to_pixel(view.camera, other.camera), view.inverse)
    ahead = (view.inverse > 0) & (z > 1e-9)
    z = torch.where(ahead, z, torch.ones_like(z))
    height, width = other.image.shape
    grid = torch.stack([2 * x / (z * width) - 1, 2 * y / (z * height) - 1], dim=-1).clamp(-2, 2)
    maps = torch.stack([other.image, other.inverse, other.valid.to(other.image.dtype)])
    brightness, inverse, valid = grid_sample(maps[None], grid[None], align_corners=False)[0]
    same = (inverse - view.inverse / z).abs() < _DEPTH_TOLERANCE_STEPS * step
    return brightness, ahead & view.valid & same & (valid > 0.99)


def _correlation(a: Tensor, b: Tensor) -> float:
    """Pearson's; 0 where either is constant."""
    a, b = a.double() - a.double().mean(), b.double() - b.double().mean()
    scale = float((a.square().sum() * b.square().sum()).sqrt())
    return float((a * b).sum()) / scale if scale > 1e-12 else 0.0
