"""Depth of a photograph by sweeping inward from a surface behind which the true one lies, such as a visual hull.

Hypotheses are offsets of inverse depth from what the surface shows, so windows lie along it and "no offset" is what the
surface itself says. Matching cost: zero-mean normalised cross-correlation over square windows, the mean of the best
half of the neighbours (which are not hidden there). Semi-global matching (Hirschmüller 2008) makes the offsets smooth:
where a window holds nothing to compare, neighbouring pixels and the surface decide.
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
"""Variance of brightness (sRGB, 0…1) at which a window is half trusted."""

_NOISE_VARIANCE = 2e-5
"""Variance below which correlations fade to 0: half a code of 8 bits."""

_BATCH_SAMPLES = 1 << 20
"""Places that are compared at once: tens of megabytes."""

_MIN_CURVATURE = 1e-3
"""Curvature of the correlation below which its summit cannot be told from rounding."""

_IMPOSSIBLE_COST = 2.0
"""Cost of a place where nothing can be."""

_MAX_STEPS_BETWEEN_PIXELS = 3.0
"""Steps of depth between neighbouring pixels above which they lie on different parts of the surface."""


@dataclass(frozen=True)
class SweptView:
    """The object's part of a photograph at one level, and what surfaces show there."""

    camera: Camera
    image: Tensor
    """H W, brightness in sRGB, black beside the object."""
    inside: Tensor
    """H W, where the object is."""
    valid: Tensor
    """H W, where no pixel of it is clipped: a highlight seems to lie behind the surface, where its mirror image is."""
    inverse: Tensor
    """H W, inverse depth of the surface that is swept from, 0 where it shows none."""
    bound: Tensor
    """H W, inverse depth of the surface in front of which nothing lies."""


@dataclass(frozen=True)
class SweepSettings:
    """What is tried, and the price of what is unlikely. The cost of a place is 1 minus its correlation, in 0…1."""

    window: int
    """Side of the compared windows in pixels, odd."""
    inward: int
    """Steps behind the surface."""
    outward: int
    """Steps in front of it: the middle of noise is not its least."""
    small_change: float = 0.1
    """Price of an offset one step away from the neighbouring pixel's."""
    large_change: float = 0.4
    """Price of one farther away."""
    departure: float = 0.05
    """Price of any place but the bound's: it stays where nothing speaks against it."""
    least_trust: float = 0.05
    """Share of that price which windows without content pay."""


def sweep(
    reference: SweptView,
    others: Sequence[SweptView],
    step: float,
    tried: SweepSettings,
    thickness: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Inverse depth (H, W), and the correlation there; both 0 where there is none.

    `step` and `thickness` (H, W), how far behind the surface there may be something, are in inverse depth.
    """
    steps = torch.arange(-tried.outward, tried.inward + 1, device=reference.image.device)
    offsets = -step * steps.float()
    base = reference.inverse
    known = reference.valid & (base > 0)
    batch = max(1, _BATCH_SAMPLES // base.numel())
    hypotheses = (base + part[:, None, None] for part in offsets.split(batch))
    scores = torch.cat([correlations(reference, others, inverse, tried.window) for inverse in hypotheses])
    price = tried.departure * texture_confidence(reference.image, tried.window).clamp_min(tried.least_trust)
    departure = ((reference.bound - (base + offsets[:, None, None])) / step).abs().clamp_max(1)
    cost = (1 - scores).clamp(0, 1) + price * departure
    if thickness is not None:
        cost = torch.where(-offsets[:, None, None] > thickness + 0.5 * step, _IMPOSSIBLE_COST, cost)
    total = semi_global(cost.permute(1, 2, 0).contiguous(), base, known, step, tried)
    best = total.argmin(dim=2)
    inside = best.clamp(1, len(steps) - 2)
    # the parabola is the data's own: smoothing draws it to whole steps
    left, middle, right = (scores.gather(0, (inside + k)[None])[0] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    shift = torch.where(bend < -_MIN_CURVATURE, 0.5 * (left - right) / bend.clamp_max(-_MIN_CURVATURE), 0.0).clamp(
        -0.5, 0.5
    )
    # at the ends of the range there is no parabola
    shift = torch.where(best == inside, shift, (best - inside).float())
    found = base - step * (inside - tried.outward + shift)
    zero = torch.zeros_like(base)
    return torch.where(known & (found > 0), found, zero), torch.where(known, scores.gather(0, best[None])[0], zero)


def semi_global(cost: Tensor, base: Tensor, known: Tensor, step: float, tried: SweepSettings) -> Tensor:
    """Costs (H, W, K), summed along four directions with a price on changes from pixel to pixel.

    A path starts anew where nothing is known, and where the surface jumps: offsets are not comparable there.
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
                    kept = torch.minimum(before, least + tried.large_change)
                    kept[:, 1:] = torch.minimum(kept[:, 1:], before[:, :-1] + tried.small_change)
                    kept[:, :-1] = torch.minimum(kept[:, :-1], before[:, 1:] + tried.small_change)
                    path += (kept - least) * joined[i - 1 if forward else i][:, None]
                sums[i] += path
                before = path
    return total


def correlations(reference: SweptView, others: Sequence[SweptView], inverse: Tensor, window: int) -> Tensor:
    """Correlations (S, H, W) with the neighbours, warped by S maps of inverse depth: the mean of the best half."""
    own = _Windows(reference.image[None], window)
    found = []
    for other in others:
        warped, seen = _warp(reference.camera, other, inverse)
        found.append(torch.where(seen, own.correlation(warped), -1.0))
    ranked = torch.stack(found).sort(dim=0, descending=True).values
    return ranked[: max(1, (len(found) + 1) // 2)].mean(dim=0)


def texture_confidence(image: Tensor, window: int) -> Tensor:
    """How much (0…1) the window around each pixel (H, W) holds that could be compared."""
    variance = _Windows(image[None], window).variance[0]
    return variance / (variance + FLAT_VARIANCE)


def inverse_depth_step(camera: Camera, others: Sequence[Camera], point: Array) -> float:
    """Change of inverse depth that moves the match of a point by a pixel in the neighbour where it moves fastest."""
    pixel, depth = camera.project(point[None])
    origin, direction = camera.rays(pixel)
    along = float(direction[0] @ camera.world_to_camera[2, :3])
    z = max(float(depth[0]), 1e-9)
    low, high = 0.999 * z, 1.001 * z
    ends = np.concatenate([origin + direction * (d / along) for d in (low, high)])
    shifts = [float(np.linalg.norm(np.diff(other.project(ends)[0], axis=0))) for other in others]
    return (1 / low - 1 / high) / max(max(shifts), 1e-6)


def _warp(camera: Camera, other: SweptView, inverse: Tensor) -> tuple[Tensor, Tensor]:
    """A neighbour's picture (S, H, W) as `camera` sees it at these inverse depths, and where it shows it."""
    _, height, width = inverse.shape
    size_y, size_x = other.image.shape
    # grid_sample's own coordinates: -1 and 1 are the outer borders
    to_grid = np.array([[2 / size_x, 0, -1], [0, 2 / size_y, -1], [0, 0, 1]])
    turn, shift = pixel_to_pixel(camera, other.camera)
    x, y, z = reproject(to_grid @ turn, to_grid @ shift, inverse)
    ahead = z > 1e-6
    z = z.clamp_min(1e-6)
    x, y = x / z, y / z
    seen = ahead & (x.abs() <= 1) & (y.abs() <= 1)
    grid = torch.stack([x, y], dim=-1).clamp_(-2, 2)
    # one tall picture of all depths, so that the neighbour's is not copied for each
    warped = grid_sample(
        other.image[None, None], grid.reshape(1, -1, width, 2), padding_mode="border", align_corners=False
    )
    return warped.reshape(-1, height, width), seen


def pixel_to_pixel(camera: Camera, other: Camera) -> tuple[Array, Array]:
    """3×3 and (3,): `other`'s pixel, times its depth over the pixel's, is `turn @ (x, y, 1) + shift / depth`."""
    pose = other.world_to_camera @ np.linalg.inv(camera.world_to_camera)
    return other.intrinsics @ pose[:3, :3] @ np.linalg.inv(camera.intrinsics), other.intrinsics @ pose[:3, 3]


def reproject(turn: Array, shift: Array, inverse: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The three coordinates of `turn @ (x, y, 1) + shift · inverse` at all pixel centres of maps (…, H, W)."""
    height, width = inverse.shape[-2:]
    rows = torch.arange(height, device=inverse.device, dtype=torch.float32)[:, None] + 0.5
    columns = torch.arange(width, device=inverse.device, dtype=torch.float32)[None, :] + 0.5
    x, y, z = (
        torch.add(
            float(turn[i, 0]) * columns + float(turn[i, 1]) * rows + float(turn[i, 2]), inverse, alpha=float(shift[i])
        )
        for i in range(3)
    )
    return x, y, z


class _Windows:
    """Windows of a reference picture (1, H, W), to be compared with those of others."""

    def __init__(self, image: Tensor, window: int) -> None:
        self._image, self._window = image, window
        self._count = box_sum(torch.ones_like(image), window)
        self._mean = self._average(image)
        self.variance = (self._average(image * image) - self._mean**2).clamp_min(0)

    def correlation(self, other: Tensor) -> Tensor:
        """Zero-mean normalised cross-correlation (S, H, W); near 0 where either window is flat."""
        mean = self._average(other)
        variance = (self._average(other * other) - mean * mean).clamp_min_(0)
        covariance = self._average(self._image * other) - self._mean * mean
        return covariance * ((self.variance + _NOISE_VARIANCE) * (variance + _NOISE_VARIANCE)).rsqrt()

    def _average(self, image: Tensor) -> Tensor:
        return box_sum(image, self._window) / self._count


def box_sum(image: Tensor, window: int) -> Tensor:
    """Sums over square windows of (S, H, W), zero beyond the border; on a processor ten times as fast as pooling."""
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
