"""Depth of a photograph by a sweep that starts at a bounding surface, such as a visual hull, and moves inwards.

Hypotheses are offsets of inverse depth from that of the surface, so that windows are parallel to it and offset 0 is the
surface itself. Matching score: zero-mean normalised cross-correlation over square windows, averaged over the best half
of the neighbours (the others may be occluded). Semi-global matching (Hirschmüller 2008) regularises the offsets: in
windows without texture, neighbouring pixels and the surface decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from hir_core.capture import Array, Camera

FLAT_VARIANCE = 1e-4
"""Variance of brightness (sRGB, 0…1) at which the confidence of a window is one half."""

_NOISE_VARIANCE = 2e-5
"""Variance below which correlations decrease to 0: half a code of 8 bits."""

_BATCH_SAMPLES = 1 << 20
"""Samples of a batch of hypotheses: tens of megabytes."""

_MIN_CURVATURE = 1e-3
"""Curvature of the correlation below which its peak is not distinguishable from rounding errors."""

_IMPOSSIBLE_COST = 2.0
"""Cost of a depth behind the object."""

_MAX_STEPS_BETWEEN_PIXELS = 3.0
"""Difference in depth between neighbouring pixels, in steps, above which there is a depth discontinuity."""


@dataclass(frozen=True)
class SweptView:
    """The object's part of a photograph at one level, with the inverse depths of two surfaces."""

    camera: Camera
    image: Tensor
    """(H, W), brightness in sRGB, black outside the object."""
    inside: Tensor
    """(H, W), object mask."""
    valid: Tensor
    """(H, W), object without clipped pixels: a highlight matches at the depth of its mirror image, behind the
    surface."""
    inverse: Tensor
    """(H, W), inverse depth of the surface where the sweep starts, 0 outside it."""
    bound: Tensor
    """(H, W), inverse depth of the bounding surface; the object is not in front of it."""


@dataclass(frozen=True)
class SweepSettings:
    """Hypotheses and regularisation. The data cost of a hypothesis is 1 minus its correlation, in 0…1."""

    window: int
    """Side of the compared windows in pixels, odd."""
    inward: int
    """Number of steps behind the surface."""
    outward: int
    """Number of steps in front of it: without these, noise would bias the depth inwards."""
    small_change: float = 0.1
    """Penalty of an offset that differs by one step from the neighbouring pixel's."""
    large_change: float = 0.4
    """Penalty of a larger difference."""
    departure: float = 0.05
    """Penalty of any depth other than the bounding surface's."""
    least_trust: float = 0.05
    """Smallest share of that penalty, for windows without texture."""


def sweep(
    reference: SweptView,
    others: Sequence[SweptView],
    step: float,
    settings: SweepSettings,
    thickness: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Inverse depth (H, W) and its correlation; both 0 where no depth was measured.

    `step` is the spacing of the hypotheses and `thickness` (H, W) the largest offset behind the surface, both in
    inverse depth.
    """
    steps = torch.arange(-settings.outward, settings.inward + 1, device=reference.image.device)
    offsets = -step * steps.float()
    base = reference.inverse
    known = reference.valid & (base > 0)
    batch = max(1, _BATCH_SAMPLES // base.numel())
    hypotheses = (base + part[:, None, None] for part in offsets.split(batch))
    scores = torch.cat([correlations(reference, others, inverse, settings.window) for inverse in hypotheses])
    penalty = settings.departure * texture_confidence(reference.image, settings.window).clamp_min(settings.least_trust)
    departure = ((reference.bound - (base + offsets[:, None, None])) / step).abs().clamp_max(1)
    cost = (1 - scores).clamp(0, 1) + penalty * departure
    if thickness is not None:
        cost = torch.where(-offsets[:, None, None] > thickness + 0.5 * step, _IMPOSSIBLE_COST, cost)
    total = semi_global(cost.permute(1, 2, 0).contiguous(), base, known, step, settings)
    best = total.argmin(dim=2)
    inside = best.clamp(1, len(steps) - 2)
    # the parabola uses the unregularised scores: regularisation biases it to whole steps
    left, middle, right = (scores.gather(0, (inside + k)[None])[0] for k in (-1, 0, 1))
    curvature = left - 2 * middle + right
    shift = torch.where(
        curvature < -_MIN_CURVATURE, 0.5 * (left - right) / curvature.clamp_max(-_MIN_CURVATURE), 0.0
    ).clamp(-0.5, 0.5)
    # no parabola at the ends of the range
    shift = torch.where(best == inside, shift, (best - inside).float())
    measured = base - step * (inside - settings.outward + shift)
    zero = torch.zeros_like(base)
    return torch.where(known & (measured > 0), measured, zero), torch.where(
        known, scores.gather(0, best[None])[0], zero
    )


def semi_global(cost: Tensor, base: Tensor, known: Tensor, step: float, settings: SweepSettings) -> Tensor:
    """Costs (H, W, K), aggregated along four directions with a penalty on changes between neighbouring pixels.

    A path restarts at unknown pixels and at depth discontinuities of the surface: offsets are not comparable there.
    """
    total = torch.zeros_like(cost)
    for axis in (0, 1):
        costs, inverse, there = (x.movedim(axis, 0) for x in (cost, base, known))
        joined = ((inverse[1:] - inverse[:-1]).abs() < _MAX_STEPS_BETWEEN_PIXELS * step) & there[1:] & there[:-1]
        sums = total.movedim(axis, 0)
        for forward in (True, False):
            before: Tensor | None = None
            for i in range(len(costs)) if forward else range(len(costs) - 1, -1, -1):
                path = costs[i].clone()
                if before is not None:
                    least = before.min(dim=1, keepdim=True).values
                    cheapest = torch.minimum(before, least + settings.large_change)
                    cheapest[:, 1:] = torch.minimum(cheapest[:, 1:], before[:, :-1] + settings.small_change)
                    cheapest[:, :-1] = torch.minimum(cheapest[:, :-1], before[:, 1:] + settings.small_change)
                    path += (cheapest - least) * joined[i - 1 if forward else i][:, None]
                sums[i] += path
                before = path
    return total


def correlations(reference: SweptView, others: Sequence[SweptView], inverse: Tensor, window: int) -> Tensor:
    """Correlations (S, H, W) with the neighbours warped by S maps of inverse depth: the mean over the best half."""
    own = _Windows(reference.image[None], window)
    measured = []
    for other in others:
        warped, seen = _warp(reference.camera, other, inverse)
        measured.append(torch.where(seen, own.correlation(warped), -1.0))
    ranked = torch.stack(measured).sort(dim=0, descending=True).values
    return ranked[: max(1, (len(measured) + 1) // 2)].mean(dim=0)


def texture_confidence(image: Tensor, window: int) -> Tensor:
    """Confidence (0…1) that the window around each pixel (H, W) has enough texture for matching."""
    variance = _Windows(image[None], window).variance[0]
    return variance / (variance + FLAT_VARIANCE)


def inverse_depth_step(camera: Camera, others: Sequence[Camera], point: Array) -> float:
    """Change of inverse depth that moves the projection of a point by at most one pixel in all neighbours."""
    pixel, depth = camera.project(point[None])
    origin, direction = camera.rays(pixel)
    along = float(direction[0] @ camera.world_to_camera[2, :3])
    z = max(float(depth[0]), 1e-9)
    low, high = 0.999 * z, 1.001 * z
    ends = np.concatenate([origin + direction * (d / along) for d in (low, high)])
    shifts = [float(np.linalg.norm(np.diff(other.project(ends)[0], axis=0))) for other in others]
    return (1 / low - 1 / high) / max(max(shifts), 1e-6)


def _warp(camera: Camera, other: SweptView, inverse: Tensor) -> tuple[Tensor, Tensor]:
    """A neighbour's image (S, H, W), warped to `camera` at these inverse depths, and where it is inside the image."""
    _, height, width = inverse.shape
    size_y, size_x = other.image.shape
    # grid_sample's own coordinates: -1 and 1 are the outer borders
    to_grid = np.array([[2 / size_x, 0, -1], [0, 2 / size_y, -1], [0, 0, 1]])
    rotation, translation = pixel_to_pixel(camera, other.camera)
    x, y, z = reproject(to_grid @ rotation, to_grid @ translation, inverse)
    ahead = z > 1e-6
    z = z.clamp_min(1e-6)
    x, y = x / z, y / z
    seen = ahead & (x.abs() <= 1) & (y.abs() <= 1)
    grid = torch.stack([x, y], dim=-1).clamp_(-2, 2)
    # one tall image of all depths, so that the neighbour's image is not copied for each of them
    warped = grid_sample(
        other.image[None, None], grid.reshape(1, -1, width, 2), padding_mode="border", align_corners=False
    )
    return warped.reshape(-1, height, width), seen


def pixel_to_pixel(camera: Camera, other: Camera) -> tuple[Array, Array]:
    """3×3 and (3,): the homogeneous pixel in `other` is `rotation @ (x, y, 1) + translation / depth`.

    Its third coordinate is the depth in `other` divided by `depth`.
    """
    pose = other.world_to_camera @ np.linalg.inv(camera.world_to_camera)
    return other.intrinsics @ pose[:3, :3] @ np.linalg.inv(camera.intrinsics), other.intrinsics @ pose[:3, 3]


def reproject(rotation: Array, translation: Array, inverse: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The three coordinates of `rotation @ (x, y, 1) + translation · inverse` at all pixel centres of maps (…, H,
    W)."""
    height, width = inverse.shape[-2:]
    rows = torch.arange(height, device=inverse.device, dtype=torch.float32)[:, None] + 0.5
    columns = torch.arange(width, device=inverse.device, dtype=torch.float32)[None, :] + 0.5
    x, y, z = (
        torch.add(
            float(rotation[i, 0]) * columns + float(rotation[i, 1]) * rows + float(rotation[i, 2]),
            inverse,
            alpha=float(translation[i]),
        )
        for i in range(3)
    )
    return x, y, z


class _Windows:
    """Statistics of the windows of a reference image (1, H, W), for the correlation with other images."""

    def __init__(self, image: Tensor, window: int) -> None:
        self._image, self._window = image, window
        self._count = box_sum(torch.ones_like(image), window)
        self._mean = self._average(image)
        self.variance = (self._average(image * image) - self._mean**2).clamp_min(0)

    def correlation(self, other: Tensor) -> Tensor:
        """Zero-mean normalised cross-correlation (S, H, W); near 0 where either window has no texture."""
        mean = self._average(other)
        variance = (self._average(other * other) - mean * mean).clamp_min_(0)
        covariance = self._average(self._image * other) - self._mean * mean
        return covariance * ((self.variance + _NOISE_VARIANCE) * (variance + _NOISE_VARIANCE)).rsqrt()

    def _average(self, image: Tensor) -> Tensor:
        return box_sum(image, self._window) / self._count


def box_sum(image: Tensor, window: int) -> Tensor:
    """Sums over square windows of (S, H, W), zero outside the border; ten times as fast as pooling on a CPU."""
    half = window // 2
    height, width = image.shape[1:]
    padded = pad(image, (half, half, half, half))
    rows = padded[:, :, :width].clone()
    for k in range(1, window):
        rows += padded[:, :, k : k + width]
    sums = rows[:, :height].clone()
    for k in range(1, window):
        sums += rows[:, k : k + height]
    return sums
