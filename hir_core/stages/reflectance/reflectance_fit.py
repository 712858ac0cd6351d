"""Stage: material and light, by the renderer's own solver and model selection, or by gradient steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.capture.photograph_exposures import (
    EQUAL_EXPOSURES,
    Exposures,
    PhotographExposures,
    with_recorded_exposures,
)
from hir_core.config import ReflectanceSettings
from hir_core.errors import CaptureError, ConfigError
from hir_core.optimization.term_gradients import value_and_gradients, why_without_effect
from hir_core.optimization.weighted_energies import Energies, prepare_energies, solver_terms
from hir_core.plugins.interfaces import FitT, PreparedReflectance, RefinementT, ReflectanceRenderer, ReflectanceSolver
from hir_core.run.machine import return_freed_memory
from hir_core.run.stage_context import StageContext, forward_warnings
from hir_core.scene import Scene
from hir_core.scene.energy_conservation import with_conserved_energy
from hir_core.scene.map_errors import MapErrors
from hir_core.stages.reflectance.camera_response import response_warning
from hir_core.stages.reflectance.error_estimate.common_errors import with_common_errors
from hir_core.stages.reflectance.error_estimate.error_estimate import PRIOR_WIDTHS, estimated_map_errors
from hir_core.stages.reflectance.gradient_fit import fit_by_gradient, gradient_steps, object_pixels
from hir_core.stages.reflectance.initial_material_and_light import initial_scene
from hir_core.stages.reflectance.light_scale import disagreement_warning, light_scale_report
from hir_core.stages.reflectance.path_traced_refinement import refine_albedo, refine_by_path_tracing
from hir_core.stages.reflectance.reflectance_report import (
    LightAndMaterial,
    ReflectanceReport,
    TermReport,
    comparison_reports,
    explanation_report,
    exposure_report,
    hypothesis_reports,
    lamp_report,
    near_tie_warning,
    shape_report,
    significant,
)
from hir_core.stages.reflectance.selection.exposure_selection import exposures_differ, exposures_to_compare
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence, fits_at_once
from hir_core.stages.reflectance.selection.model_selection import Selection, select_model
from hir_core.stages.reflectance.selection.requested_model import default_spec, forced_spec
from hir_core.stages.reflectance.selection.shape_selection import OtherShape, ShapeComparison
from hir_core.stages.reflectance.stage_progress import StageProgress
from hir_core.stages.reflectance.take_support import check_takes


@dataclass(frozen=True, eq=False)
class FittedReflectance:
    """What the stage found."""

    scene: Scene
    """With material and light."""
    exposures: PhotographExposures
    map_errors: MapErrors | None
    """How certain the maps are; None where that was not estimated."""
    report: ReflectanceReport
    """How the model was selected, and what each step gained."""
    held_out_errors: NDArray[np.float64] | None = None
    """Mean squared errors of the selected model on held-out views; None where nothing was compared."""
    with_other_mesh: ShapeComparison[Any] | None = None
    """The comparison with another mesh, which was not selected; None where there was none."""


def fit_reflectance(
    scene: Scene,
    capture: Capture,
    settings: ReflectanceSettings,
    context: StageContext,
    silhouette_positions: Float[Tensor, "V 3"] | None = None,
    other_scene: Callable[[], Scene] | None = None,
) -> FittedReflectance:
    """Material and light fitted to the photographs.

    With `silhouette_positions`, the vertices before photo-consistency moved them, held-out views decide which of both
    shapes the scene has. With `other_scene`, which makes the scene with another mesh, `OtherMeshSelectedError` where
    held-out views prefer that one.
    """
    if not settings.renderer:
        raise ConfigError("reflectance.renderer is not set; choose a preset that sets it, or set it yourself")
    options = context.options.get("reflectance_renderer", {}).get(settings.renderer, {})
    traits = context.plugins.find("reflectance_renderer", settings.renderer).component.traits
    offers_solver = "solver" in traits
    if settings.method == "solver" and not offers_solver:
        raise ConfigError(
            f"reflectance.method is 'solver', but the renderer {settings.renderer!r} has none; "
            "choose another reflectance.renderer, or set reflectance.method to 'gradient'"
        )
    _check_exposure(capture, settings.downsample)
    by_solver = offers_solver and settings.method != "gradient"
    check_takes(capture, settings, traits)
    capture = with_recorded_exposures(capture)
    exposures = exposures_to_compare(capture, settings, settings.renderer, by_solver and "exposures" in traits)
    fits_lamp = by_solver and "camera_lamp" in traits
    if settings.light_frame == "lamp" and not fits_lamp:
        raise ConfigError(
            f"reflectance.light_frame is 'lamp', which the fit of {settings.renderer!r} does not support; choose "
            "another reflectance.renderer, reflectance.method=auto or reflectance.light_frame=auto"
        )
    renderer: ReflectanceRenderer = context.plugins.create(
        "reflectance_renderer", settings.renderer, options, context.seed
    )
    initial = initial_scene(scene, capture, settings, by_solver)
    prepared = renderer.prepare(initial, capture, settings.downsample)

    def on_silhouettes() -> PreparedReflectance:
        assert silhouette_positions is not None
        moved = replace(initial, mesh=initial.mesh.with_positions(silhouette_positions))
        return renderer.prepare(moved, capture, settings.downsample)

    def on_other_mesh() -> PreparedReflectance:
        assert other_scene is not None
        return renderer.prepare(
            initial_scene(other_scene(), capture, settings, by_solver), capture, settings.downsample
        )

    with forward_warnings(context):
        if by_solver and isinstance(prepared, ReflectanceSolver):
            takes_terms = "regularizers" in traits
            others = (
                None if silhouette_positions is None else on_silhouettes,
                None if other_scene is None else on_other_mesh,
            )
            fitted, used, shading, report, selection = _fit_by_solver(
                initial, prepared, others, takes_terms, exposures, fits_lamp, capture, settings, context
            )
        else:
            fitted, report = _fit_by_gradient(initial, prepared, capture, settings, context)
            used, shading, selection = EQUAL_EXPOSURES, prepared, None
    if settings.conserve_energy and fitted.material is not None:
        material, clamped = with_conserved_energy(fitted.material)
        fitted = replace(fitted, material=material)
        report = replace(report, clamped_share=round(clamped, 5))
    if capture.takes != ("",) and not fitted.take_radiance and fitted.environment is not None:
        fitted = replace(fitted, take_radiance={capture.takes[0]: fitted.environment.radiance})
    light_scale = light_scale_report(fitted, capture, bool(settings.known_environment))
    if warning := disagreement_warning(light_scale):
        context.warn(warning)
    errors = None
    if settings.map_errors:
        errors = estimated_map_errors(fitted, shading, used.applied_to(capture), settings.downsample, context.seed)
        if errors is not None and fitted.material is not None and not settings.known_environment:
            errors = with_common_errors(errors, fitted.material, PRIOR_WIDTHS)
    report = replace(report, light_scale=light_scale, map_errors=None if errors is None else errors.report())
    if selection is None:
        return FittedReflectance(fitted, used, errors, report)
    return FittedReflectance(fitted, used, errors, report, selection.held_out_errors, selection.mesh)


def _fit_by_solver(
    scene: Scene,
    solver: ReflectanceSolver[FitT, RefinementT],
    others: tuple[Callable[[], PreparedReflectance] | None, Callable[[], PreparedReflectance] | None],
    takes_terms: bool,
    exposures: Sequence[Exposures],
    fits_lamp: bool,
    capture: Capture,
    settings: ReflectanceSettings,
    context: StageContext,
) -> tuple[Scene, PhotographExposures, PreparedReflectance, ReflectanceReport, Selection[FitT]]:
    """Also what shades the scene with all that was modelled, and how the model was selected.

    `others`: the same mesh in another shape, and another mesh. `takes_terms`: the solver minimises the regularizers
    itself; otherwise gradient steps with them follow it.
    """
    views = list(range(len(capture.views)))
    terms = solver_terms(settings.regularizers, context.plugins, context.seed, context.part_seconds)
    if terms and takes_terms:
        solver = solver.with_terms(terms)

    def solver_of(prepare: Callable[[], PreparedReflectance] | None) -> OtherShape[FitT, RefinementT] | None:
        def prepared() -> ReflectanceSolver[FitT, RefinementT]:
            assert prepare is not None
            other: ReflectanceSolver[FitT, RefinementT] = prepare()  # type: ignore[assignment]
            return other.with_terms(terms) if terms and takes_terms else other

        return None if prepare is None else prepared

    other_shape, other_mesh = map(solver_of, others)
    progress = StageProgress(context)
    at_once = fits_at_once(solver, terms, context.device)
    fits = FitSequence(solver, progress.selecting, context.checkpoints, context.checkpoint_seconds, at_once)
    selection = select_model(
        fits,
        settings,
        len(views),
        progress,
        other_shape,
        exposures,
        fits_lamp,
        takes=capture.take_numbers,
        exposures_differ=len(exposures) > 1 and exposures_differ(scene.mesh, capture),
        camera_positions=np.stack([camera.center for camera in capture.cameras]),
        other_mesh=other_mesh,
    )
    solver = fits.solver
    fit, spec = selection.fit, selection.spec
    if not selection.compared and forced_spec(settings) is None:
        takes = f" of {len(capture.takes)} takes" if len(capture.takes) > 1 else ""
        context.warn(
            f"{len(views)} views{takes} are too few to hold some out, so no models were compared; the model is "
            f"{spec.name}. Take at least 6 photographs{' in each take' if takes else ''} to have the model selected"
        )
    if warning := near_tie_warning(selection):
        context.warn(warning)
    if selection.compared:
        report_share = progress.phase("all views", f"{spec.name}, all views")
        fit = solver.fit(spec, fit, views, 1.0, report_share, fits.checkpoint(spec, views, 1.0))
    return_freed_memory()  # of the selection, before textures need the most
    solved = solver.scene(fit, views, progress.phase("textures"))
    photographed = capture
    used = PhotographExposures.of(
        spec.exposures, capture, None if solved.exposures is None else solved.exposures.cpu().numpy()
    )
    capture = used.applied_to(capture)
    found_exposures = exposure_report(selection.exposures, used, photographed)
    if found_exposures is not None and (warning := response_warning(found_exposures.response)):
        context.warn(warning)
    refinement = None
    if settings.path_tracing.refine_albedo:  # before gradient steps, whose effect it would undo
        report_share = progress.phase("path tracing")
        solved, refinement = refine_albedo(solved, solver, capture, settings, spec.bounces, context, report_share)
    fitted, path_tracing = solved.scene, None
    energies = prepare_energies(fitted, settings.regularizers, context.plugins, context.seed)
    steps = gradient_steps(settings.gradient, len(views))
    if energies and not takes_terms and not steps and not settings.path_tracing.iterations:
        context.warn(
            f"the regularizers {', '.join(energies.terms)} act in gradient steps after the solver of "
            f"{settings.renderer!r}, and reflectance.gradient.iterations is 0: they have no effect"
        )
    gradient = None
    if energies and steps and not takes_terms:
        fitted, gradient = fit_by_gradient(
            fitted,
            solved.prepared,
            object_pixels(capture, views, settings.downsample, str(scene.mesh.positions.device)),
            settings.gradient,
            energies,
            context,
            steps=steps,
            conserve_energy=settings.conserve_energy,
            fit_light=not settings.known_environment,
            fit_specular=spec.brdf != "diffuse",
        )
    if settings.path_tracing.iterations:
        fitted, path_tracing = refine_by_path_tracing(fitted, capture, settings, energies, context)
    return (
        fitted,
        used,
        solved.prepared,
        ReflectanceReport(
            method="solver",
            model=spec.name,
            light_frame=spec.light,
            fitted=LightAndMaterial.of(fitted),
            bounces=spec.bounces,
            explanation=explanation_report(selection),
            hypotheses=hypothesis_reports(selection),
            comparisons=comparison_reports(selection),
            lamp=lamp_report(selection),
            shape=shape_report(selection),
            takes=list(fitted.take_radiance) or None,
            exposures=found_exposures,
            regularizers=_reported(energies, fitted, "solver" if takes_terms else "gradient steps", context),
            solver=solved.report,
            gradient=gradient,
            albedo_refinement=refinement,
            path_tracing=path_tracing,
        ),
        selection,
    )


def _fit_by_gradient(
    scene: Scene, prepared: PreparedReflectance, capture: Capture, settings: ReflectanceSettings, context: StageContext
) -> tuple[Scene, ReflectanceReport]:
    assert scene.environment is not None
    views = list(range(len(capture.views)))
    spec = forced_spec(settings) or default_spec(settings)
    energies = prepare_energies(scene, settings.regularizers, context.plugins, context.seed)
    fitted, gradient = fit_by_gradient(
        scene,
        prepared,
        object_pixels(capture, views, settings.downsample, str(scene.mesh.positions.device)),
        settings.gradient,
        energies,
        context,
        steps=gradient_steps(settings.gradient, len(views)),
        conserve_energy=settings.conserve_energy,
        fit_light=not settings.known_environment,
        fit_specular=spec.brdf != "diffuse",
    )
    return fitted, ReflectanceReport(
        method="gradient",
        model=spec.name,
        light_frame=scene.environment.frame,
        fitted=LightAndMaterial.of(fitted),
        gradient=gradient,
        regularizers=_reported(energies, fitted, "gradient steps", context),
    )


def _reported(
    energies: Energies, fitted: Scene, acted_in: Literal["solver", "gradient steps"], context: StageContext
) -> dict[str, TermReport] | None:
    """Weight and value of each term; warns of those that had no effect."""
    reports: dict[str, TermReport] = {}
    for name, (weight, energy) in energies.terms.items():
        value, gradients = value_and_gradients(energy, fitted)
        traits = context.plugins.find("regularizer", name).component.traits
        if why := why_without_effect(fitted, gradients, traits if acted_in == "solver" else None):
            context.warn(f"regularizer {name} {why}")
        reports[name] = TermReport(weight, significant(float(value)), acted_in)
    return reports or None


def _check_exposure(capture: Capture, downsample: int) -> None:
    """Raises `CaptureError` where the object is clipped in every pixel of every photograph.

    Reads photographs up to the first one that shows an unclipped pixel of the object.
    """
    seen = False
    for view in capture.views:
        pixels = view.pixels(downsample)
        inside = np.ones(pixels.saturated.shape, bool) if pixels.mask is None else pixels.mask > 0.5
        if (inside & ~pixels.saturated).any():
            return
        seen |= bool(inside.any())
    if seen:
        raise CaptureError(
            f"{capture.path}: every pixel of the object is clipped in all {len(capture.views)} photographs, so its "
            "colour is unknown; expose less, or fit the shape alone with --set reflectance.enabled=false"
        )
