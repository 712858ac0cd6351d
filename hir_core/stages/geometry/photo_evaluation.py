"""Evaluates meshes on held-out views: photo-consistency error, IoU, and how much of a movement these views confirm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import stdtrit
from torch import Tensor
from torch.nn.functional import huber_loss

from hir_core.scene import Mesh
from hir_core.stages.geometry.detail_images import DetailImages
from hir_core.stages.geometry.photo_consistency import photo_consistency_residuals, sample_pairs
from hir_core.stages.geometry.photo_consistency_report import ConfirmedShare

HUBER_DELTA_CONTRAST = 0.5
"""In units of local contrast: a larger difference is an outlier, such as an occluder or a highlight."""

EVALUATED_PIXELS_PER_VIEW = 2000

IOU_LOSS_MAX = 0.002
"""Of the held-out views' silhouettes; the vertices go only as far as that."""


@dataclass(frozen=True)
class HeldOutEvaluation:
    """How well a mesh explains views that took no part in its fit."""

    errors: NDArray[np.float64]
    """Error of each judging view; NaN where nothing could be compared."""
    iou: float
    """Mean over the held-out views."""


def huber(residuals: Float[Tensor, "Q 3"]) -> Float[Tensor, "Q 3"]:
    """The robust error of each residual."""
    return huber_loss(residuals, torch.zeros_like(residuals), delta=HUBER_DELTA_CONTRAST, reduction="none")


def evaluate_held_out(
    mesh: Mesh,
    details: DetailImages,
    neighbours: Sequence[Sequence[int]],
    judges: Sequence[int],
    held_out: Sequence[int],
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    seed: int,
) -> HeldOutEvaluation:
    """The photo-consistency error of `judges` and the IoU of `held_out`.

    Compares the same random pixels whatever the mesh; pairs that the mesh hides from a view are left out.
    """
    errors = []
    with torch.no_grad():
        for view in judges:
            generator = np.random.default_rng((seed, view))
            pairs = sample_pairs(details, neighbours, [view], EVALUATED_PIXELS_PER_VIEW, generator)
            residuals, _ = photo_consistency_residuals(mesh, details, pairs)
            errors.append(float(huber(residuals).mean()) if len(residuals) else np.nan)
        mean_iou = float(iou(mesh, list(held_out)).mean())
    return HeldOutEvaluation(np.array(errors), mean_iou)


def interpolated(start: Mesh, end: Mesh, share: float) -> Mesh:
    """`start` with its vertices moved by `share` of the way to those of `end`; the same mesh where the share is 0."""
    return start if share == 0 else start.with_positions(torch.lerp(start.positions, end.positions, share).detach())


def confirmed_share(
    lengths: Sequence[float], errors: Float[NDArray[np.float64], "T V"], least_gain: float
) -> ConfirmedShare:
    """How far to go along a line between two meshes, from the errors of V held-out views at T `lengths` (0, …, 1).

    A parabola through the mean relative errors has its minimum at length t, with a gain g and its standard error s
    over the views. The share is t · g²/(g² + least_gain²) · g⁴/(g⁴ + s⁴): Wiener's weight of a signal g, and a steeper
    one for the noise, most of which is that views show different parts. It is continuous in the errors. Views with an
    error that is not finite, or 0 at the start, are left out; 0 for fewer than two views.
    """
    known = np.isfinite(errors).all(axis=0) & (errors[0] > 0)
    count = int(known.sum())
    if count < 2:
        return ConfirmedShare(0.0, 0.0, 0.0, True)
    gains = 1 - errors[:, known] / errors[0, known]
    slope, curvature = _parabola(np.asarray(lengths, np.float64), -gains.mean(axis=1))
    length = 0.0 if slope >= 0 else 1.0 if -slope >= 2 * curvature else -slope / (2 * curvature)
    compared = length or 1.0
    gain = -(slope + curvature * compared) * compared
    noise = float(np.std([np.interp(compared, lengths, view) for view in gains.T], ddof=1) / np.sqrt(count))
    weight = 1 / ((1 + (least_gain / gain) ** 2) * (1 + (noise / gain) ** 4)) if gain > 1e-9 else 0.0
    share = length * weight
    near_tie = abs(gain) < float(stdtrit(count - 1, 0.975)) * noise or 0.1 < share < 0.9
    return ConfirmedShare(share, gain, noise, near_tie)


def confirmed_movement(
    start: Mesh, end: Mesh, evaluated: Callable[[Mesh], HeldOutEvaluation], lengths: Sequence[float], least_gain: float
) -> tuple[ConfirmedShare, tuple[float, float]]:
    """The share of the way from `start` to `end` that the judging views confirm, as far as silhouettes allow it, and
    the IoU at both ends of that part.

    The meshes at `lengths` (0, …, 1) of the way are evaluated.
    """
    found = [evaluated(interpolated(start, end, length)) for length in lengths]
    confirmed = confirmed_share(lengths, np.stack([each.errors for each in found]), least_gain)
    iou = [each.iou for each in found]
    share = min(confirmed.share, _allowed_by_iou(lengths, iou))
    return replace(confirmed, share=share), (iou[0], float(np.interp(share, lengths, iou)))


def _allowed_by_iou(lengths: Sequence[float], iou: Sequence[float]) -> float:
    """Where the loss of IoU along the line, linear in between, exceeds `IOU_LOSS_MAX` for the first time; else 1."""
    for (near, loss), (far, next_loss) in pairwise(zip(lengths, [iou[0] - value for value in iou], strict=True)):
        if next_loss > IOU_LOSS_MAX:
            return near + (far - near) * (IOU_LOSS_MAX - loss) / (next_loss - loss)
    return 1.0


def _parabola(lengths: NDArray[np.float64], change: NDArray[np.float64]) -> tuple[float, float]:
    """b and c ≥ 0 of b·t + c·t², by least squares."""
    slope, curvature = np.linalg.lstsq(np.stack([lengths, lengths**2], axis=1), change, rcond=None)[0]
    if curvature < 0:
        return float(lengths @ change / (lengths @ lengths)), 0.0
    return float(slope), float(curvature)


def mean_known(errors: NDArray[np.float64]) -> float | None:
    """Mean over the views in which something could be compared, in five decimals; None where there are none."""
    known = errors[np.isfinite(errors)]
    return round(float(known.mean()), 5) if len(known) else None
