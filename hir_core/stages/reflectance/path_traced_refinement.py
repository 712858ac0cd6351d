"""Path-traced refinement after a fast fit, accepted only where held-out views gain.

Either the diffuse albedo is solved in closed form under path-traced radiance, or gradient steps run through the path
tracer. As many folds are compared as give `MIN_HELD_OUT_VIEWS` held-out views.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.optimization.clipped_pixels import without_clipped_excess
from hir_core.optimization.weighted_energies import Energies
from hir_core.plugins.interfaces import FitT, RefinementT, Solved
from hir_core.rendering.reference_renderer import check_light, reference_renderer
from hir_core.rendering.take_radiance import radiance_in_takes
from hir_core.scene import Scene
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.held_out_views import Fold, folds_of_a_comparison, model_selection_folds
from hir_core.stages.reflectance.gradient_fit import ObjectPixels, fit_by_gradient, object_pixels
from hir_core.stages.reflectance.reflectance_report import RefinementReport
from hir_core.stages.reflectance.selection.held_out_comparison import (
    REQUIRED_STANDARD_ERRORS,
    SUFFICIENT_DB,
    critical_value,
    is_within_noise,
    mean_decibels,
    paired_gain,
)

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer, ReflectanceSolver
    from hir_core.run.stage_context import StageContext

MAX_COMPARED_PIXELS = 4096
"""Pixels of each held-out view that are compared, the same before and after."""
COMPARED_RENDERINGS = 2
"""Renderings whose mean is compared, twice: the noise of one has a bias in sRGB, which is not linear."""
PATHS_PER_PIXEL = 32
"""For the closed form: a texel averages the noise of some five pixels."""
FINAL_LEARNING_RATE = 0.1
"""Of the gradient steps, as a share of the first."""


def refine_by_path_tracing(
    scene: Scene, capture: Capture, settings: ReflectanceSettings, energies: Energies, context: StageContext
) -> tuple[Scene, RefinementReport]:
    """The scene after `path_tracing.iterations` gradient steps, or unchanged where held-out views do not gain.

    The steps use the training views of the fold that is compared; after several folds they are repeated with all views.
    With too few views for a comparison the scene is unchanged, with a warning.
    """
    options = settings.path_tracing
    folds = _compared_folds(capture)
    if not folds:
        context.warn("too few views to hold some out: path-traced refinement was skipped")
        return scene, RefinementReport(False, 0, "too few views")
    began = time.perf_counter()
    check_light(context.plugins, options.renderer, scene.environment)
    given = context.options.get("reflectance_renderer", {}).get(options.renderer, {})
    renderer: ReflectanceRenderer = context.plugins.create(
        "reflectance_renderer", options.renderer, given, context.seed
    )
    prepared = renderer.prepare(scene, capture, settings.downsample)
    device = str(scene.mesh.positions.device)
    assert scene.material is not None
    fit_specular = bool((scene.material.specular_albedo > 0).any())
    gradient = replace(
        settings.gradient, learning_rate=options.learning_rate, learning_rate_end=FINAL_LEARNING_RATE, batch="pixels"
    )

    def steps(views: Sequence[int], checkpoint: str) -> Scene:
        fitted, _ = fit_by_gradient(
            scene,
            prepared,
            object_pixels(capture, views, settings.downsample, device),
            gradient,
            energies,
            context,
            steps=options.iterations,
            conserve_energy=settings.conserve_energy,
            fit_light=not settings.known_environment,
            fit_specular=fit_specular,
            checkpoint=checkpoint,
        )
        return fitted

    before, after, fitted = [], [], scene
    for number, (training, held_out) in enumerate(folds):
        compared = [object_pixels(capture, [view], settings.downsample, device) for view in held_out]
        fitted = steps(training, f"path_tracing_{number}")
        before.append(view_errors(scene, prepared, capture, compared, context.seed))
        after.append(view_errors(fitted, prepared, capture, compared, context.seed))
    report = _compared(before, after, options.renderer, options.iterations)
    if report.accepted and len(folds) > 1:
        fitted = steps(range(len(capture.views)), "path_tracing")
    if not report.accepted:
        context.warn(
            f"path tracing for {time.perf_counter() - began:.0f} s changed held-out views by {report.gain_db:+.2f} ± "
            f"{report.standard_error_db:.2f} dB: the result without it was kept"
        )
    return fitted if report.accepted else scene, report


def refine_albedo(
    solved: Solved[RefinementT],
    solver: ReflectanceSolver[FitT, RefinementT],
    capture: Capture,
    settings: ReflectanceSettings,
    bounces: int,
    context: StageContext,
    report: Callable[[float], None] = lambda share: None,
) -> tuple[Solved[RefinementT], RefinementReport]:
    """The scene with its albedo solved under path-traced radiance, or unchanged where held-out views do not gain.

    They compare two albedos that are solved from the other views of each fold, with path tracing and without; an
    accepted one is solved from all views. `report` receives the share that is done.
    """
    report(0.0)
    folds = _compared_folds(capture)
    if not folds:
        return solved, RefinementReport(False, 0, "too few views")
    name = settings.path_tracing.renderer
    options = dict(context.options.get("reflectance_renderer", {}).get(name, {}))
    config = context.plugins.find("reflectance_renderer", name).component.config
    if "samples" in getattr(config, "__dataclass_fields__", {}):
        options.setdefault("samples", PATHS_PER_PIXEL)
    _, renderer = reference_renderer(context.plugins, name, options, bounces, light=solved.scene.environment)
    traced = renderer.prepare(solved.scene, capture, settings.downsample)
    device = str(solved.scene.mesh.positions.device)
    before, after = [], []
    for number, (training, held_out) in enumerate(folds):

        def report_fold(share: float, number: int = number) -> None:
            report(0.75 * (number + share) / len(folds))

        without = solver.refine(solved, None, training, lambda share: None)
        refined = solver.refine(solved, traced, training, report_fold)
        if without is None or refined is None:
            judges = sum(len(fold[1]) for fold in folds)
            return solved, RefinementReport(False, judges, "the solver has no closed form for the albedo")
        compared = [object_pixels(capture, [view], settings.downsample, device) for view in held_out]
        before.append(view_errors(without.scene, traced, capture, compared, context.seed))
        after.append(view_errors(refined.scene, traced, capture, compared, context.seed))
    result = _compared(before, after, name)
    if result.accepted:
        whole = solver.refine(solved, traced, range(len(capture.views)), lambda share: report(0.85 + 0.15 * share))
        assert whole is not None, "the solver could for fewer views"
        solved = whole
    return solved, result


def _compared_folds(capture: Capture) -> list[Fold]:
    folds = model_selection_folds(len(capture.views), capture.take_numbers)
    return [folds[number] for number in folds_of_a_comparison(folds)]


def _compared(
    before_of_folds: Sequence[NDArray[np.float64]],
    after_of_folds: Sequence[NDArray[np.float64]],
    renderer: str,
    steps: int | None = None,
) -> RefinementReport:
    before, after = np.concatenate(before_of_folds), np.concatenate(after_of_folds)
    gain, standard_error = paired_gain(before, after)
    return RefinementReport(
        accepted=bool(gain > critical_value(REQUIRED_STANDARD_ERRORS, len(before)) * standard_error),
        held_out_views=len(before),
        near_tie=is_within_noise(gain, standard_error, len(before)),
        renderer=renderer,
        steps=steps,
        before_db=round(mean_decibels(before), 3),
        after_db=round(mean_decibels(after), 3),
        gain_db=round(gain, 3),
        standard_error_db=round(standard_error, 3),
    )


def view_errors(
    scene: Scene, prepared: PreparedReflectance, capture: Capture, views: Sequence[ObjectPixels], seed: int
) -> NDArray[np.float64]:
    """Mean squared sRGB error of each view, over pixels drawn from `seed`; no error where a clipped pixel is brighter.

    The errors of two independent renderings are multiplied, so that the mean does not contain the path tracer's noise.
    What is left of it is nearly the error of an almost exact view: no error is below that of `SUFFICIENT_DB`.
    """
    samples = [_sample(pixels, (seed, number)) for number, pixels in enumerate(views)]
    index, color, saturated = (torch.cat([part[k] for part in samples]) for k in range(3))
    with torch.no_grad():
        torch.manual_seed(seed)
        one, other = (_residual(scene, prepared, capture, index, color, saturated) for _ in range(2))
    squares = (one * other).mean(dim=1)
    means = np.array([float(part.mean()) for part in squares.split([len(part[0]) for part in samples])])
    return np.maximum(means, 10 ** (-SUFFICIENT_DB / 10))


def _residual(
    scene: Scene, prepared: PreparedReflectance, capture: Capture, index: Tensor, color: Tensor, saturated: Tensor
) -> Float[Tensor, "P 3"]:
    """sRGB error in float64 of the mean of `COMPARED_RENDERINGS`."""
    renderings = [radiance_in_takes(prepared, scene, capture, index) for _ in range(COMPARED_RENDERINGS)]
    difference = linear_to_srgb(torch.stack(renderings).mean(dim=0).clamp(0, 1)) - linear_to_srgb(color.clamp(0, 1))
    return without_clipped_excess(difference, saturated).double()


def _sample(pixels: ObjectPixels, seed: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Index (N, 3), colour (N, 3) and saturation (N, 1) of at most `MAX_COMPARED_PIXELS`, drawn from `seed`."""
    drawn = np.random.default_rng(seed).permutation(len(pixels.index))[:MAX_COMPARED_PIXELS]
    rows = torch.from_numpy(np.sort(drawn)).to(pixels.index.device)
    return pixels.index[rows], pixels.color[rows], pixels.saturated[rows]
