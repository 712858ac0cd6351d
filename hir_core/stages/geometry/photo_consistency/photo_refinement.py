"""Photo-consistency refinement: vertices move until photographs agree about the surface; silhouettes keep the outline.

Silhouettes do not constrain hollows. After they fit, points of the surface are compared between neighbouring views
of one take (`photo_consistency`), from coarse photographs to fine ones. From the mesh of the coarsest level two
candidates are optimised: a smooth one, and a fine one with less smoothing. Views that took no part judge how far the
result goes from the smooth one towards the fine one, and from the initial mesh towards that (`confirmed_share`). Both
shares are continuous in the errors, so that noise in a few views changes the mesh a little. A last pass refines with
the judging views too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import groupby

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GeometrySettings
from hir_core.mesh.large_steps import LargeSteps
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.confirmed_movement import (
    HeldOutEvaluation,
    HeldOutIou,
    confirmed_movement,
    confirmed_share,
    interpolated,
)
from hir_core.stages.geometry.photo_consistency.compared_pixels import away_from_occlusion_boundaries
from hir_core.stages.geometry.photo_consistency.detail_images import DetailImages, finest_downsample
from hir_core.stages.geometry.photo_consistency.passes_at_once import one_at_a_time, passes_at_once, run_passes
from hir_core.stages.geometry.photo_consistency.photo_consistency_report import (
    ErrorChange,
    PassReport,
    PhotoConsistencyReport,
    PhotoConsistencySkipped,
)
from hir_core.stages.geometry.photo_consistency.photo_error import evaluate_held_out, mean_known
from hir_core.stages.geometry.photo_consistency.photo_pass import (
    FINE_SMOOTHNESS,
    SMOOTHNESS,
    Pass,
    fit_pass,
    plan_passes,
)
from hir_core.stages.geometry.photo_consistency.photo_residuals import neighbouring_views, ray_structure
from hir_core.stages.held_out_views import judging_views

COARSEST_FACTOR = 4
"""The first level uses photographs at this fraction of the finest resolution that is used."""

LEAST_SIDE_PIXELS = 48
"""A smaller photograph has no detail left to compare."""

LINE = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the way between two meshes at which held-out views are evaluated."""

LEAST_GAIN = 0.005
"""Relative fall of the error of judging views of which half is believed, even where they agree."""

LEAST_FINE_GAIN = 0.03
"""The same of the fine candidate against the smooth one. Where there is nothing to carve it roughens the normals;
photo-consistency does not measure that, but highlights show it."""

LEAST_EARLY_GAIN = 0.01
"""Relative fall of the error of judging views after the coarsest of several resolutions, two standard errors added,
below which nothing finer is fitted (docs/studies/photo_consistency.md#early-end)."""

LEAST_ERROR = 1e-4
"""Below it there is nothing to lower: photographs without detail are consistent with every surface."""


def refine_by_photo_consistency(
    mesh: Mesh,
    capture: Capture,
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    held_out: Sequence[int],
    settings: GeometrySettings,
    context: StageContext,
) -> tuple[Mesh, PhotoConsistencyReport | PhotoConsistencySkipped]:
    """The refined mesh, or the initial one where no part of the refinement is confirmed, and the report.

    `capture` has the object centred and of radius about 1; `iou(mesh, views)` is differentiable. The views `held_out`
    take no part in the fit; others that judge with them join its last pass. Without them, without overlapping views, or
    where the coarsest of several resolutions gains nothing, the mesh is returned as it is and the report says why.
    """
    views, takes = capture.views, capture.take_numbers
    judges = judging_views(len(views), held_out, takes)
    train = [i for i in range(len(views)) if i not in set(judges)]
    neighbours = neighbouring_views(capture.cameras, train, takes)
    judges = [i for i in judges if neighbours[i]]
    if not judges or not any(neighbours[i] for i in train):
        return mesh, PhotoConsistencySkipped("too few views that overlap and could be held out")
    factors = _downsample_factors(capture, settings.downsample)

    tracer = ray_structure(mesh)

    def details_at(factor: int) -> DetailImages:
        return away_from_occlusion_boundaries(DetailImages.of(views, factor, mesh.positions.device), tracer)

    finest = details_at(factors[-1])

    def evaluated(candidate: Mesh, details: DetailImages = finest) -> HeldOutEvaluation:
        return evaluate_held_out(candidate, details, neighbours, judges, held_out, iou, context.seed)

    def why_no_finer(candidate: Mesh, details: DetailImages) -> str:
        errors = np.stack([evaluated(each, details).errors for each in (mesh, candidate)])
        if np.isfinite(errors).all(axis=0).sum() < 2:
            return ""  # no window is away from boundaries; finer photographs have smaller ones
        early = confirmed_share((0.0, 1.0), errors, LEAST_GAIN)
        if early.gain + 2 * early.noise >= LEAST_EARLY_GAIN:
            return ""
        gain, noise = 100 * early.gain, 100 * early.noise
        return f"at the coarsest resolution the judging views gain {gain:.1f} ± {noise:.1f} %, too little to go on"

    before = evaluated(mesh)
    if not np.nanmax(before.errors, initial=0.0) > LEAST_ERROR:
        return mesh, PhotoConsistencySkipped("the photographs show no detail to compare")
    large_steps = cache(partial(LargeSteps, mesh.topology, len(mesh.positions)))
    candidates = dict.fromkeys((SMOOTHNESS, FINE_SMOOTHNESS), mesh)
    reports = []
    at_once, shared_iou = passes_at_once(mesh.positions.device), one_at_a_time(iou)
    passes, last = plan_passes(factors, settings.photo_consistency_iterations)
    for downsample, group in groupby(passes, key=lambda plan: plan.downsample):
        plans = list(group)
        details = details_at(downsample) if downsample != factors[-1] else finest
        fits = [
            partial(
                fit_pass,
                candidates[plan.smoothness],
                details,
                neighbours,
                train,
                shared_iou,
                settings,
                plan=plan,
                total_steps=last.end,
                large=large_steps(plan.smoothness),
            )
            for plan in plans
        ]
        for plan, (fitted, curve) in zip(plans, run_passes(fits, context, at_once), strict=True):
            candidates |= dict.fromkeys(candidates if plan.shared else [plan.smoothness], fitted)
            reports.append(_pass_report(plan, curve))
            if plan.shared and (reason := why_no_finer(fitted, details)):
                return mesh, PhotoConsistencySkipped(reason)
    smooth, fine = candidates.values()
    to_fine, _ = confirmed_movement(smooth, fine, evaluated, LINE, LEAST_FINE_GAIN)
    selected = interpolated(smooth, fine, to_fine.share)
    movement, _ = confirmed_movement(mesh, selected, evaluated, LINE, LEAST_GAIN)
    result = mesh
    if movement.share > 0:
        everything = [i for i in range(len(views)) if i not in set(held_out)]
        near = neighbouring_views(capture.cameras, everything, takes)
        large = large_steps(last.smoothness)
        selected, curve = fit_pass(
            selected, finest, near, everything, iou, settings, context, plan=last, total_steps=last.end, large=large
        )
        reports.append(_pass_report(last, curve))
        result = interpolated(mesh, selected, movement.share)
    after = evaluate_held_out(result, finest, neighbours, held_out, held_out, iou, context.seed)
    report = PhotoConsistencyReport(
        accepted=movement.share > 0,
        judging_views=[views[i].name for i in judges],
        levels=reports,
        movement=movement.rounded(),
        fine=to_fine.rounded(),
        held_out_error=ErrorChange(
            mean_known(before.errors[[i in set(held_out) for i in judges]]), mean_known(after.errors)
        ),
        held_out_iou=HeldOutIou(round(before.iou, 5), round(after.iou, 5)),
    )
    return result, report


def _pass_report(plan: Pass, curve: NDArray[np.floating]) -> PassReport:
    ends = [round(float(v), 5) for v in _means_of_ends(curve)]
    return PassReport(plan.smoothness, plan.downsample, plan.shared, ends)


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
