"""Photo-consistency refinement: vertices move until photographs agree about the surface; silhouettes keep the outline.

Silhouettes do not constrain hollows. After they fit, points of the surface are compared between neighbouring views
(`photo_consistency`), from coarse photographs to fine ones. From the mesh of the coarsest level two candidates are
optimised: a smooth one, and a fine one with less smoothing. Held-out views select one, and the result is accepted only
where they are more consistent with it than with the initial mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GeometrySettings
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.detail_images import DetailImages, finest_downsample
from hir_core.stages.geometry.photo_consistency import neighbouring_views
from hir_core.stages.geometry.photo_consistency_report import (
    ErrorChange,
    FineCandidateReport,
    HeldOutIou,
    PassReport,
    PhotoConsistencyReport,
    PhotoConsistencySkipped,
)
from hir_core.stages.geometry.photo_evaluation import evaluate_held_out, mean_known, relative_gain
from hir_core.stages.geometry.photo_pass import FINE_SMOOTHNESS, SMOOTHNESS, fit_pass, plan_passes

COARSEST_FACTOR = 4
"""The first level uses photographs at this fraction of the finest resolution that is used."""

LEAST_SIDE_PIXELS = 48
"""A smaller photograph has no detail left to compare."""

SIGNIFICANCE = 1.0
"""Standard errors that a gain must exceed: the better of two meshes is selected, no term is added to a model."""

LEAST_GAIN = 0.005
"""Share by which the error of held-out views must fall."""

LEAST_FINE_GAIN = 0.03
"""Share by which the fine candidate's error must be below the smooth one's, and by a standard error too. Where there is
nothing to carve it roughens the normals; photo-consistency does not measure that, but highlights show it (spot: error
−1 %, unseen views −0.5 dB)."""

LEAST_ERROR = 1e-4
"""Below it there is nothing to lower: photographs without detail are consistent with every surface."""

IOU_LOSS_MAX = 0.002


def refine_by_photo_consistency(
    mesh: Mesh,
    capture: Capture,
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    held_out: Sequence[int],
    settings: GeometrySettings,
    context: StageContext,
) -> tuple[Mesh, PhotoConsistencyReport | PhotoConsistencySkipped]:
    """The refined mesh, or the initial one where the refinement is not accepted, and the report.

    `capture` has the object centred and of radius about 1; `iou(mesh, views)` is differentiable. The views `held_out`
    take no part in the fit and decide. Without them, or without overlapping views, the mesh is returned as it is and
    the report says why.
    """
    views = capture.views
    train = [i for i in range(len(views)) if i not in set(held_out)]
    neighbours = neighbouring_views(capture.cameras, train)
    deciding = [i for i in held_out if neighbours[i]]
    if not deciding or not any(neighbours[i] for i in train):
        return mesh, PhotoConsistencySkipped("too few views that overlap and could be held out")
    factors = _downsample_factors(capture, settings.downsample)
    finest = DetailImages.of(views, factors[-1])
    before = evaluate_held_out(mesh, finest, neighbours, deciding, iou, context.seed)
    if not np.nanmax(before.errors, initial=0.0) > LEAST_ERROR:
        return mesh, PhotoConsistencySkipped("the photographs show no detail to compare")
    candidates = dict.fromkeys((SMOOTHNESS, FINE_SMOOTHNESS), mesh)
    passes = []
    for downsample, plans in groupby(plan_passes(factors), key=lambda plan: plan.downsample):
        details = finest if downsample == factors[-1] else DetailImages.of(views, downsample)
        for plan in plans:
            initial = candidates[plan.smoothness]
            fitted, curve = fit_pass(initial, details, neighbours, train, iou, settings, context, plan)
            candidates |= dict.fromkeys(candidates if plan.shared else [plan.smoothness], fitted)
            ends = [round(float(v), 5) for v in _means_of_ends(curve)]
            passes.append(PassReport(plan.smoothness, downsample, plan.shared, ends))
    smooth, fine = (
        evaluate_held_out(candidate, finest, neighbours, deciding, iou, context.seed)
        for candidate in candidates.values()
    )
    fine_gain, fine_noise = relative_gain(smooth.errors, fine.errors)
    fine_is_better = (
        fine_gain > max(SIGNIFICANCE * fine_noise, LEAST_FINE_GAIN) and fine.iou > smooth.iou - IOU_LOSS_MAX
    )
    selected = candidates[FINE_SMOOTHNESS if fine_is_better else SMOOTHNESS]
    after = fine if fine_is_better else smooth
    gain, noise = relative_gain(before.errors, after.errors)
    accepted = gain > max(SIGNIFICANCE * noise, LEAST_GAIN) and after.iou > before.iou - IOU_LOSS_MAX
    report = PhotoConsistencyReport(
        accepted=accepted,
        levels=passes,
        fine=FineCandidateReport(accepted and fine_is_better, round(fine_gain, 5), round(fine_noise, 5)),
        held_out_gain=round(gain, 5),
        noise=round(noise, 5),
        held_out_error=ErrorChange(mean_known(before.errors), mean_known(after.errors)),
        held_out_iou=HeldOutIou(round(before.iou, 5), round(after.iou, 5)),
    )
    return (selected if accepted else mesh), report


def _downsample_factors(capture: Capture, downsample: int) -> list[int]:
    """Coarse to fine, each half of the one before; the finest is always among them."""
    finest = finest_downsample(capture.views, downsample)
    side = min(min(camera.width, camera.height) for camera in capture.cameras)
    factors, factor = [], COARSEST_FACTOR
    while factor >= 1:
        if side >= LEAST_SIDE_PIXELS * finest * factor or factor == 1:
            factors.append(finest * factor)
        factor //= 2
    return factors


def _means_of_ends(curve: NDArray[np.floating]) -> list[float]:
    """Mean of the first and of the last tenth; empty for an empty curve."""
    part = max(1, len(curve) // 10)
    return [float(np.mean(curve[:part])), float(np.mean(curve[-part:]))] if len(curve) else []
