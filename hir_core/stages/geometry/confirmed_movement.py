"""How much of a movement of the vertices is confirmed by views that took no part in it.

Each refinement of the mesh (outlines, photo-consistency, occlusion boundaries) moves the vertices on a part of the
views. The others evaluate meshes along the way and decide how far it goes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import stdtrit

from hir_core.scene import Mesh

IOU_LOSS_MAX = 0.002
"""Of the held-out views' silhouettes; the vertices go only as far as that."""


@dataclass(frozen=True)
class ConfirmedShare:
    """The share of a movement of the vertices that held-out views confirm."""

    share: float
    """0…1."""
    gain: float
    """Mean relative fall of the error over the views at the length of lowest error, or at 1 where that is 0."""
    noise: float
    """Standard error of the gain."""
    near_tie: bool
    """Student's 95 % interval of the gain contains 0, or the share is between 0.1 and 0.9."""

    def rounded(self) -> ConfirmedShare:
        """For the report."""
        return ConfirmedShare(round(self.share, 4), round(self.gain, 5), round(self.noise, 5), self.near_tie)


@dataclass(frozen=True)
class HeldOutIou:
    """Mean IoU of the held-out views."""

    before: float
    after: float


@dataclass(frozen=True)
class HeldOutEvaluation:
    """How well a mesh explains views that took no part in its fit."""

    errors: NDArray[np.float64]
    """Error of each judging view; NaN where nothing could be compared."""
    iou: float
    """Mean over the held-out views."""


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
