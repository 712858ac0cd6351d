"""How far masks lie beside the visual hull of other masks: with right cameras the hull contains the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera

MIN_VIEWS = 12
"""Masks below which the hull of the others is too coarse to compare."""

_TESTED_VIEWS = 12
"""Evenly spaced; each is compared with the hull of the masks of all other folds."""
_FOLDS = 4
_TOLERATED_SHARE = 0.04
"""A point is carved away where more than this share of the masks show background there."""
_OUTLINE_POINTS = 60
_DEPTHS, _WIDTHS = np.array([0.25, 0.75, 1.5, 3.0]), np.array([0.5, 0.5, 1.0, 2.0])
"""Distances inside the outline at which rays are traced, and the width of the strip that each stands for, in pixels."""
_SAMPLES = 256
"""Along each ray, through the box of the hull."""


def silhouette_gap(views: Sequence[tuple[Camera, NDArray[np.float32]]], low: Array, high: Array) -> float | None:
    """Mean width of the strip along a mask's outline that no point of the hull of other masks covers, in pixels of the
    masks: the median over views. `low` and `high` (3,) are corners of a box around the object. None for few masks.

    Wider strips than four pixels count as four.
    """
    if len(views) < MIN_VIEWS:
        return None
    cameras, masks = [camera for camera, _ in views], [mask for _, mask in views]
    tested = np.unique(np.linspace(0, len(views) - 1, _TESTED_VIEWS).round().astype(int))
    # neighbours carve the same points: in random order most points are decided by a few masks
    order = np.random.default_rng(0).permutation(len(views))
    center, size = (low + high) / 2, float((high - low).max())
    projections = [_projection(camera, center, size) for camera in cameras]
    gaps = []
    for view in tested:
        pixels, strip = _strip(masks[view])
        if not len(pixels):
            continue
        points = _ray_samples(cameras[view], pixels, low, high)
        others = [i for i in order if i % _FOLDS != view % _FOLDS]
        covered = _in_hull(
            ((points - center) / size).astype(np.float32).reshape(-1, 3),
            [projections[i] for i in others],
            [masks[i] for i in others],
        )
        beside = ~covered.reshape(len(pixels), _SAMPLES).any(axis=1)
        share = np.bincount(strip, beside, len(_WIDTHS)) / np.maximum(np.bincount(strip, minlength=len(_WIDTHS)), 1)
        gaps.append(float(share @ _WIDTHS))
    return float(np.median(gaps)) if gaps else None


def _strip(mask: NDArray[np.float32]) -> tuple[Array, NDArray[np.int64]]:
    """Pixels (N, 2) inside the 0.5 contour of a mask, and the strip (N,) of each: its index in `_DEPTHS`."""
    crossings = []
    for axis in (0, 1):
        a, b = np.delete(mask, -1, axis), np.delete(mask, 0, axis)
        at = np.argwhere((a > 0.5) != (b > 0.5))
        first, second = a[tuple(at.T)], b[tuple(at.T)]
        place = at + 0.5
        place[:, axis] += (0.5 - first) / (second - first)
        crossings.append(place[:, ::-1])
    outline = np.concatenate(crossings)
    outline = outline[np.linspace(0, max(len(outline) - 1, 0), min(_OUTLINE_POINTS, len(outline))).round().astype(int)]
    padded = np.pad(mask.astype(np.float64), 1, mode="edge")
    smooth = (padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4
    smooth = (smooth[:, :-2] + 2 * smooth[:, 1:-1] + smooth[:, 2:]) / 4
    down, right = (np.asarray(each, np.float64) for each in np.gradient(smooth))
    slope = np.stack([_bilinear(each, outline[:, 0], outline[:, 1]) for each in (right, down)], axis=1)
    inward = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)
    pixels = (outline[:, None] + _DEPTHS[None, :, None] * inward[:, None]).reshape(-1, 2)
    strip = np.tile(np.arange(len(_DEPTHS)), len(outline))
    x, y = pixels[:, 0], pixels[:, 1]
    inside = (x > 0) & (y > 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    inside[inside] = _bilinear(mask, x[inside], y[inside]) > 0.5
    return pixels[inside], strip[inside]


def _ray_samples(camera: Camera, pixels: Array, low: Array, high: Array) -> Array:
    """Points (N, S, 3) on the rays through pixels, between the sides of a box."""
    origins, directions = camera.rays(pixels)
    safe = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    sides = np.stack([(low - origins) / safe, (high - origins) / safe])
    near, far = np.maximum(sides.min(axis=0).max(axis=1), 0.0), sides.max(axis=0).min(axis=1)
    at = near[:, None] + (np.maximum(far, near) - near)[:, None] * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    samples: Array = origins[:, None] + at[..., None] * directions[:, None]
    return samples


def _projection(camera: Camera, center: Array, size: float) -> NDArray[np.float32]:
    """3×4, to pixels times depth, of points relative to `center` in units of `size`."""
    pose = camera.world_to_camera[:3]
    moved = np.concatenate([pose[:, :3] * size, (pose[:, :3] @ center + pose[:, 3])[:, None]], axis=1) / size
    return (camera.intrinsics @ moved).astype(np.float32)


def _in_hull(
    points: NDArray[np.float32], projections: Sequence[NDArray[np.float32]], masks: Sequence[NDArray[np.float32]]
) -> NDArray[np.bool_]:
    """Which points (N,) are object in nearly all masks, of those that see them, and seen by more than half."""
    tolerated = int(_TOLERATED_SHARE * len(masks))
    left, result = np.arange(len(points)), np.zeros(len(points), bool)
    misses, unseen = np.zeros(len(points), np.int32), np.zeros(len(points), np.int32)
    for projection, mask in zip(projections, masks, strict=True):
        height, width = mask.shape
        local = points @ projection[:, :3].T + projection[:, 3]
        ahead = np.maximum(local[:, 2], 1e-6)
        x, y = local[:, 0] / ahead, local[:, 1] / ahead
        seen = (local[:, 2] > 1e-6) & (x >= 0) & (y >= 0) & (x <= width) & (y <= height)
        value = _bilinear(mask, np.where(seen, x, 0), np.where(seen, y, 0))
        misses += seen & (value <= 0.5)
        unseen += ~seen
        keep = misses <= tolerated
        if not keep.all():
            points, left, misses, unseen = points[keep], left[keep], misses[keep], unseen[keep]
    result[left[2 * unseen < len(masks)]] = True
    return result


def _bilinear(values: NDArray[np.floating], x: Array, y: Array) -> Array:
    """Values (N,) between pixel centres at .5; beyond the outermost ones they continue."""
    height, width = values.shape
    u, v = np.clip(x - 0.5, 0, width - 1), np.clip(y - 0.5, 0, height - 1)
    i, j = np.minimum(u.astype(np.int32), width - 2), np.minimum(v.astype(np.int32), height - 2)
    at = j * width + i
    flat = values.reshape(-1)
    u, v = u - i, v - j
    upper = flat[at] + u * (flat[at + 1] - flat[at])
    lower = flat[at + width] + u * (flat[at + width + 1] - flat[at + width])
    return upper + v * (lower - upper)
