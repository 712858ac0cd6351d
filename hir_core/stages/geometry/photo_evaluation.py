"""Evaluates a mesh on held-out views: photo-consistency error, IoU, and the significance of a gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import huber_loss

from hir_core.scene import Mesh
from hir_core.stages.geometry.detail_images import DetailImages
from hir_core.stages.geometry.photo_consistency import photo_consistency_residuals, sample_pairs

HUBER_DELTA_CONTRAST = 0.5
"""In units of local contrast: a larger difference is an outlier, such as an occluder or a highlight."""

EVALUATED_PIXELS_PER_VIEW = 2000


@dataclass(frozen=True)
class HeldOutEvaluation:
    """How well a mesh explains views that took no part in its fit."""

    errors: NDArray[np.float64]
    """Photo-consistency error of each view; NaN where nothing could be compared."""
    iou: float
    """Mean over the views."""


def huber(residuals: Float[Tensor, "Q 3"]) -> Float[Tensor, "Q 3"]:
    """The robust error of each residual."""
    return huber_loss(residuals, torch.zeros_like(residuals), delta=HUBER_DELTA_CONTRAST, reduction="none")


def evaluate_held_out(
    mesh: Mesh,
    details: DetailImages,
    neighbours: Sequence[Sequence[int]],
    held_out: list[int],
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    seed: int,
) -> HeldOutEvaluation:
    """Compares the same random pixels whatever the mesh; pairs that the mesh hides from a view are left out."""
    errors = []
    with torch.no_grad():
        for view in held_out:
            generator = np.random.default_rng((seed, view))
            pairs = sample_pairs(details, neighbours, [view], EVALUATED_PIXELS_PER_VIEW, generator)
            residuals, _ = photo_consistency_residuals(mesh, details, pairs)
            errors.append(float(huber(residuals).mean()) if len(residuals) else np.nan)
        mean_iou = float(iou(mesh, held_out).mean())
    return HeldOutEvaluation(np.array(errors), mean_iou)


def relative_gain(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float]:
    """Mean relative fall of the error over the views and its standard error; (0, 0) for fewer than two known views."""
    known = np.isfinite(before) & np.isfinite(after) & (before > 0)
    if known.sum() < 2:
        return 0.0, 0.0
    gains = 1 - after[known] / before[known]
    return float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(known.sum()))


def mean_known(errors: NDArray[np.float64]) -> float | None:
    """Mean over the views in which something could be compared, in five decimals; None where there are none."""
    known = errors[np.isfinite(errors)]
    return round(float(known.mean()), 5) if len(known) else None
