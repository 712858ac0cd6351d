"""Depth of each photograph by comparing it with its neighbours: plane sweep, then refinement from coarse to fine.

Matching cost: zero-mean normalised cross-correlation over a square window, the mean of the best half of the neighbours
(which are not hidden there). The first sweep is over planes of constant inverse depth; each finer level moves the depth
map it was given by small steps, so that windows lie along the surface and not parallel to the picture.
"""
# ruff: noqa: TID253 - loaded when it runs

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate

from hir_core.capture import Array, Camera

_FLAT = 2e-5
"""Variance of brightness below which a window holds nothing to compare."""

_BATCH_PIXELS = 1 << 20
"""Depth hypotheses that are compared at once: a few hundred megabytes."""


@dataclass(frozen=True)
class StereoView:
    """A photograph for matching."""

    camera: Camera
    image: NDArray[np.float32]
    """H W, brightness in sRGB."""
    valid: NDArray[np.bool_]
    """H W, where the object may be."""

    def cropped(self, margin: int, multiple: int) -> StereoView:
        """The part around `valid`, its sides multiples of `multiple` where the picture has room."""
        rows, columns = np.nonzero(self.valid.any(axis=1))[0], np.nonzero(self.valid.any(axis=0))[0]
        if not len(rows):
            return self
        spans = []
        for used, size in ((rows, self.camera.height), (columns, self.camera.width)):
            low, high = max(int(used[0]) - margin, 0), min(int(used[-1]) + 1 + margin, size)
            high = min(low + -(-(high - low) // multiple) * multiple, size)
            spans.append((low, high))
        (top, bottom), (left, right) = spans
        intrinsics = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1.0]]) @ self.camera.intrinsics
        camera = replace(self.camera, intrinsics=intrinsics, width=right - left, height=bottom - top)
        part = (slice(top, bottom), slice(left, right))
        return StereoView(camera, np.ascontiguousarray(self.image[part]), np.ascontiguousarray(self.valid[part]))


@dataclass(frozen=True)
class DepthMap:
    """Depth along the camera's axis; 0 where there is none."""

    camera: Camera
    depth: NDArray[np.float32]
    """H W."""
    score: NDArray[np.float32]
    """H W, correlation in -1…1."""


def neighbours(cameras: Sequence[Camera], center: Array, count: int) -> list[list[int]]:
    """For each camera those whose direction to the object differs by about 10°, the nearest to that first."""
    toward = np.array([c.center - center for c in cameras])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(toward @ toward.T, -1, 1)))
    # too near measures no depth, too far looks different: a ratio of 2 either way costs the same
    cost = np.abs(np.log(np.maximum(angle, 0.5) / 10.0))
    cost[angle < 1.5] = np.inf
    cost[angle > 50] = np.inf
    np.fill_diagonal(cost, np.inf)
    return [[int(j) for j in np.argsort(row, kind="stable")[:count] if np.isfinite(row[j])] for row in cost]


def depth_map(
    reference: StereoView, others: Sequence[StereoView], near: float, far: float, planes: int, window: int, levels: int,
    device: str = "cpu",
) -> DepthMap:  # fmt: skip
    """The reference's depth between `near` and `far`; at most `planes` of them in the first sweep."""
    factors = [2**i for i in reversed(range(levels))]
    depth: Tensor | None = None
    score = torch.zeros(1)
    for factor in factors:
        ref = _tensors(reference, factor, device)
        rest = [_tensors(other, factor, device) for other in others]
        # the whole levels' resolution in inverse depth: one pixel of the widest neighbour
        pixel = _inverse_depth_step(ref, rest, near, far)
        if depth is None:
            wanted = int((1 / near - 1 / far) / pixel) + 1
            count = int(np.clip(wanted, 8, planes))
            inverse = torch.linspace(1 / near, 1 / far, count, device=device)
            base = torch.zeros_like(ref.image)
            depth, score = _best(ref, rest, base, inverse, window)
        else:
            height, width = ref.image.shape
            depth = interpolate(depth[None, None], size=(height, width), mode="bilinear", align_corners=False)[0, 0]
            for reach in (2.0, 0.5):
                steps = torch.linspace(-reach, reach, 7, device=device) * pixel
                depth, score = _best(ref, rest, depth, steps, window)
        depth = _median(depth.clamp(1 / far, 1 / near))
    assert depth is not None
    ref = _tensors(reference, 1, device)
    valid = ref.valid & (depth > 1 / far * 1.001) & (depth < 1 / near * 0.999)
    metric = torch.where(valid, 1 / depth, torch.zeros_like(depth))
    score = torch.where(valid, score, -torch.ones_like(score))
    return DepthMap(reference.camera, metric.cpu().numpy(), score.cpu().numpy())


@dataclass(frozen=True)
class _Level:
    camera: Camera
    image: Tensor
    valid: Tensor


def _tensors(view: StereoView, factor: int, device: str) -> _Level:
    camera = view.camera.downsampled(factor)
    image = torch.from_numpy(view.image)[: camera.height * factor, : camera.width * factor].to(device)
    valid = torch.from_numpy(view.valid)[: camera.height * factor, : camera.width * factor].to(device)
    if factor > 1:
        image = avg_pool2d(image[None, None], factor)[0, 0]
        valid = avg_pool2d(valid[None, None].float(), factor)[0, 0] > 0
    return _Level(camera, image, valid)


def _inverse_depth_step(ref: _Level, rest: Sequence[_Level], near: float, far: float) -> float:
    """Change of inverse depth that moves a match by one pixel in the neighbour with the longest baseline."""
    shifts = []
    center = np.array([[ref.camera.width / 2, ref.camera.height / 2]])
    origin, direction = ref.camera.rays(center)
    along = float(direction[0] @ ref.camera.world_to_camera[2, :3])
    low, high = 2 / (1 / near + 1 / far) * 0.999, 2 / (1 / near + 1 / far) * 1.001
    for other in rest:
        ends = np.concatenate([origin + direction * (z / along) for z in (low, high)])
        pixels, _ = other.camera.project(ends)
        shifts.append(float(np.linalg.norm(pixels[1] - pixels[0])))
    change = 1 / low - 1 / high
    return change / max(max(shifts), 1e-6)


def _best(ref: _Level, rest: Sequence[_Level], base: Tensor, steps: Tensor, window: int) -> tuple[Tensor, Tensor]:
    """Inverse depth (H, W) = base + the best of `steps`, to a fraction of a step by a parabola; and its score."""
    batch = max(1, _BATCH_PIXELS // base.numel())
    scores = torch.cat([_scores(ref, rest, base + part[:, None, None], window) for part in steps.split(batch)])
    top, index = scores.max(dim=0)
    inside = index.clamp(1, len(steps) - 2)
    left, middle, right = (scores.gather(0, (inside + k)[None])[0] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    shift = torch.where(bend < -1e-6, 0.5 * (left - right) / bend.clamp_max(-1e-6), torch.zeros_like(bend))
    # at the end of the range there is no parabola
    shift = torch.where(index == inside, shift.clamp(-0.5, 0.5), (index - inside).float())
    spacing = steps[1] - steps[0]
    return base + steps[inside] + shift * spacing, top


def _scores(ref: _Level, rest: Sequence[_Level], inverse: Tensor, window: int) -> Tensor:
    """Correlations (S, H, W) with the neighbours, warped by S inverse depth maps: the mean of the best half."""
    moments = _moments(ref.image[None], window)
    found = []
    for other in rest:
        warped, seen = _warp(ref, other, inverse)
        found.append(torch.where(seen, _correlation(ref.image[None], warped, moments, window), -1.0))
    ranked = torch.stack(found).sort(dim=0, descending=True).values
    return ranked[: max(1, (len(found) + 1) // 2)].mean(dim=0)


def _warp(ref: _Level, other: _Level, inverse: Tensor) -> tuple[Tensor, Tensor]:
    """The neighbour's picture (S, H, W) as the reference sees it at these inverse depths, and where it shows it."""
    _, height, width = inverse.shape
    pose = other.camera.world_to_camera @ np.linalg.inv(ref.camera.world_to_camera)
    turn = other.camera.intrinsics @ pose[:3, :3] @ np.linalg.inv(ref.camera.intrinsics)
    shift = other.camera.intrinsics @ pose[:3, 3]
    rows = torch.arange(height, device=inverse.device, dtype=torch.float32) + 0.5
    columns = torch.arange(width, device=inverse.device, dtype=torch.float32) + 0.5
    x, y, z = (
        (float(turn[i, 0]) * columns[None, :] + float(turn[i, 1]) * rows[:, None] + float(turn[i, 2]))[None]
        + float(shift[i]) * inverse
        for i in range(3)
    )
    behind = z <= 1e-6
    z = torch.where(behind, 1.0, z)
    size_y, size_x = other.image.shape
    grid = torch.stack([x / z * (2 / size_x) - 1, y / z * (2 / size_y) - 1], dim=-1).clamp(-2, 2)
    seen = ~behind & (grid.abs() <= 1).all(dim=-1)
    # one tall picture of all depths, so that the neighbour's is not copied for each
    warped = grid_sample(
        other.image[None, None], grid.reshape(1, -1, width, 2), padding_mode="border", align_corners=False
    )
    return warped.reshape(-1, height, width), seen


def _moments(image: Tensor, window: int) -> tuple[Tensor, Tensor]:
    mean = _box(image, window)
    return mean, (_box(image * image, window) - mean * mean).clamp_min(0)


def _correlation(a: Tensor, b: Tensor, moments: tuple[Tensor, Tensor], window: int) -> Tensor:
    mean_a, var_a = moments
    mean_b, var_b = _moments(b, window)
    covariance = _box(a * b, window) - mean_a * mean_b
    correlation = covariance * ((var_a + _FLAT) * (var_b + _FLAT)).rsqrt()
    return torch.where((var_a > _FLAT) & (var_b > _FLAT), correlation, correlation.clamp_max(0.0))


def _box(image: Tensor, window: int) -> Tensor:
    """Mean over windows of (S, H, W); rows then columns, for a square window costs its side squared."""
    half = window // 2
    rows = avg_pool2d(image[:, None], (1, window), stride=1, padding=(0, half), count_include_pad=False)
    return avg_pool2d(rows, (window, 1), stride=1, padding=(half, 0), count_include_pad=False)[:, 0]


def _median(image: Tensor) -> Tensor:
    """Median of 3×3: single wrong pixels do not survive to the next level."""
    padded = torch.nn.functional.pad(image[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    height, width = image.shape
    parts = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return torch.stack(parts).median(dim=0).values
