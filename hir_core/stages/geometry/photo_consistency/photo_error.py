"""The photo-consistency error of a mesh on views that took no part in its fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import huber_loss

from hir_core.scene import Mesh
from hir_core.stages.geometry.confirmed_movement import HeldOutEvaluation
from hir_core.stages.geometry.photo_consistency.detail_images import DetailImages
from hir_core.stages.geometry.photo_consistency.photo_residuals import photo_consistency_residuals, sample_pairs

HUBER_DELTA_CONTRAST = 0.5
"""In units of local contrast: a larger difference is an outlier, such as an occluder or a highlight."""

EVALUATED_PIXELS_PER_VIEW = 2000


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


def mean_known(errors: NDArray[np.float64]) -> float | None:
    """Mean over the views in which something could be compared, in five decimals; None where there are none."""
    known = errors[np.isfinite(errors)]
    return round(float(known.mean()), 5) if len(known) else None
