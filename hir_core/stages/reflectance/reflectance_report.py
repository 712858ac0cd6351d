"""The report of the reflectance stage: what run.json holds of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from hir_core.capture import Capture
from hir_core.capture.photograph_exposures import Exposures, PhotographExposures
from hir_core.plugins.interfaces import FitT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Scene
from hir_core.stages.reflectance.camera_response import ResponseReport, camera_response
from hir_core.stages.reflectance.light_scale import ASSUMED, LightScaleReport
from hir_core.stages.reflectance.selection.exposure_selection import ExposureSelection
from hir_core.stages.reflectance.selection.held_out_comparison import is_within_noise
from hir_core.stages.reflectance.selection.hypotheses import described, forcing_settings
from hir_core.stages.reflectance.selection.model_selection import Selection
from hir_core.stages.reflectance.selection.shape_selection import ShapeComparison


@dataclass(frozen=True)
class HypothesisReport:
    """One hypothesis of the model selection; dB rounded to 0.001."""

    hypothesis: str
    """Kind of material and light."""
    kind: str
    light_frame: str
    """`world`, `camera`, or `lamp`: a lamp near the camera beside a light in the world."""
    held_out_db: tuple[float, ...]
    """Mean PSNR on held-out views after each round that it took part in."""
    dropped: bool
    """Whether it was dropped before the last round, because it could not catch up."""
    margin_db: float | None = None
    """How far it is behind the selected one, in the last fits that both had; None for the selected one."""
    standard_error_db: float | None = None


@dataclass(frozen=True)
class ExplanationReport:
    """The selected hypothesis beside the runner-up."""

    chosen: str
    runner_up: str | None = None
    """None where the settings left one hypothesis."""
    margin_db: float | None = None
    standard_error_db: float | None = None
    held_out_views: int | None = None
    near_tie: bool = False
    """Whether the margin is within noise; not where the runner-up contains the selected hypothesis."""
    sentence: str = ""
    """All of it in words."""


@dataclass(frozen=True)
class ComparisonReport:
    """One refinement, or one hypothesis that was compared again; dB rounded to 0.001."""

    model: str
    """Name of the candidate."""
    spec: ModelSpec
    held_out_db: float
    gain_db: float
    standard_error_db: float
    held_out_views: int
    accepted: bool
    near_tie: bool
    """Whether the gain is within noise, two standard errors."""


@dataclass(frozen=True)
class OtherShapeReport:
    """The selected hypothesis on another shape, against the same fits on the first one; in dB."""

    held_out_db: tuple[float, ...]
    """Mean PSNR on held-out views after each round, on the other shape."""
    gain_db: float
    """Of the other shape."""
    standard_error_db: float
    held_out_views: int
    near_tie: bool
    """Whether the gain is within noise, two standard errors."""
    sentence: str
    """All of it in words."""


@dataclass(frozen=True)
class ShapeReport(OtherShapeReport):
    """The mesh of the silhouettes beside the refined one."""

    silhouettes_selected: bool
    """Whether the mesh is that of the silhouettes: what photo-consistency changed is undone."""


@dataclass(frozen=True)
class UnchangedMeshReport(OtherShapeReport):
    """The mesh without what initializers changed beside the changed one."""

    initializers: tuple[str, ...]
    """Whose change was left out."""
    selected: bool
    """Whether the result has the mesh without their change."""


@dataclass(frozen=True)
class RevisionReport:
    """Whether initializers revised the mesh with the fitted material and light, and what held-out views say of it."""

    initializers: tuple[str, ...]
    details: Mapping[str, Mapping[str, Any]]
    """What each of them reports."""
    changed: bool
    """Whether they changed the mesh, so that everything was fitted again; what follows is known then."""
    accepted: bool = False
    """Whether the result has the revised mesh."""
    gain_db: float | None = None
    """Of the fit on the revised mesh, on held-out views."""
    standard_error_db: float | None = None
    held_out_views: int | None = None
    near_tie: bool | None = None
    """Whether the gain is within noise, two standard errors."""
    sentence: str = ""
    """All of it in words."""


@dataclass(frozen=True)
class LampReport:
    """Whether hypotheses with a lamp near the camera took part: a short fit of the simplest of them, in dB."""

    took_part: bool
    compared_with: str
    """The hypothesis without a lamp that was nearest to it."""
    gain_db: float
    standard_error_db: float
    held_out_views: int
    near_tie: bool
    """Whether the gain is within noise, two standard errors."""


@dataclass(frozen=True)
class ExposureReport:
    """Which exposures the photographs have, and how they differ; in dB and stops (factors of two)."""

    selected: Exposures
    brightness_stops: float
    """From the darkest to the brightest photograph."""
    white_balance_stops: float
    """Largest range of the red or blue factor beside the green one."""
    factors: Mapping[str, tuple[float, float, float]]
    """Of red, green and blue by name of the photograph; rounded to 0.0001."""
    compared_with: Exposures
    gain_db: float | None
    """Over `compared_with` on held-out views, with the simplest model; None where the settings name the exposures."""
    standard_error_db: float | None
    held_out_views: int | None
    near_tie: bool | None
    """Whether the gain is within noise, two standard errors; None where nothing was compared."""
    sentence: str
    """All of it in words."""
    response: ResponseReport | None = None
    """Of fitted exposures beside recorded ones; None where these are missing or too much alike."""


@dataclass(frozen=True)
class RefinementReport:
    """A step after the fit that is accepted only where held-out views gain: mean PSNR on them before and after."""

    accepted: bool
    held_out_views: int
    not_compared: str | None = None
    """Why nothing was compared."""
    renderer: str | None = None
    steps: int | None = None
    """Gradient steps; None for a closed form."""
    before_db: float | None = None
    after_db: float | None = None
    gain_db: float | None = None
    standard_error_db: float | None = None
    near_tie: bool | None = None
    """Whether the gain is within noise, two standard errors; None where nothing was compared."""


@dataclass(frozen=True)
class GradientReport:
    """A fit by gradient steps."""

    steps: int
    skipped: Mapping[str, int]
    """Steps that were skipped because a term or its gradient was not finite, by term."""


@dataclass(frozen=True)
class TermReport:
    """A regularizer of the fit; its processor time is in timings.json."""

    weight: float
    value: float
    """Unweighted, at the fitted scene; 4 significant digits."""
    acted_in: Literal["solver", "gradient steps"]


@dataclass(frozen=True)
class LightAndMaterial:
    """Averages of the fitted light and material."""

    light_mean: tuple[float, ...]
    """RGB."""
    light_max: float
    brdf: str
    specular_albedo: float
    roughness_alpha: float
    lamp_intensity: tuple[float, ...] | None = None
    """RGB, of the lamp near the camera in the working frame, where the object has radius 1; None without one."""
    lamp_offset: tuple[float, ...] | None = None
    """Its place in the camera's axes, in the working frame."""
    lamp_exponent: float | None = None
    """Of its lobe of emission."""
    lamp_radius: float | None = None
    """Of its disc, in the working frame."""

    @classmethod
    def of(cls, scene: Scene) -> LightAndMaterial:
        """Of a fitted scene."""
        assert scene.environment is not None and scene.material is not None
        radiance, material = scene.environment.radiance, scene.material
        lamp = scene.environment.lamp
        return cls(
            tuple(round(float(v), 5) for v in radiance.mean(dim=(0, 1))),
            round(float(radiance.max()), 4),
            material.model,
            round(float(material.specular_albedo.mean()), 5),
            round(float(material.roughness.mean()), 5),
            None if lamp is None else tuple(round(float(v), 4) for v in lamp.intensity),
            None if lamp is None else tuple(round(float(v), 4) for v in lamp.offset),
            None if lamp is None else round(float(lamp.exponent), 3),
            None if lamp is None else round(float(lamp.radius), 4),
        )


@dataclass(frozen=True)
class ReflectanceReport:
    """What the stage fitted, how the model was selected, and what each later step gained."""

    method: Literal["solver", "gradient"]
    model: str
    """Name of the fitted model."""
    light_frame: str
    """`world`, `camera`, or `lamp`: a lamp near the camera beside a light in the world."""
    fitted: LightAndMaterial
    bounces: int | None = None
    """Reflections between parts of the surface that the solver modelled."""
    explanation: ExplanationReport | None = None
    """What kind of material under what kind of light explains the photographs; None where none were compared."""
    hypotheses: tuple[HypothesisReport, ...] = ()
    comparisons: tuple[ComparisonReport, ...] = ()
    lamp: LampReport | None = None
    """None where no hypothesis with a lamp was considered."""
    shape: ShapeReport | None = None
    """Which shape the material was fitted on; None where nothing was compared."""
    unchanged_mesh: UnchangedMeshReport | None = None
    """Whether the mesh keeps what initializers with the trait `revises_mesh` changed; None where nothing was
    compared."""
    revision: RevisionReport | None = None
    """Whether the mesh was revised after the fit; None where no initializer was asked."""
    takes: Sequence[str] | None = None
    """Takes of the photographs, each of which has its own light; None where all have one."""
    exposures: ExposureReport | None = None
    """None where all photographs have the same."""
    light_scale: LightScaleReport = ASSUMED
    """Where the scale between albedo and light comes from."""
    solver: Mapping[str, Any] | None = None
    """Figures of the solver's own."""
    gradient: GradientReport | None = None
    regularizers: Mapping[str, TermReport] | None = None
    """By name; None without any."""
    albedo_refinement: RefinementReport | None = None
    path_tracing: RefinementReport | None = None
    map_errors: Mapping[str, Any] | None = None
    """Standard errors of the maps; None where they were not estimated."""
    clamped_share: float | None = None
    """Share of diffuse albedo values that energy conservation reduced."""

    def as_document(self) -> dict[str, Any]:
        """For run.json: without optional parts that are None, light and material at the top."""
        document = asdict(self)
        return _without_none(document | document.pop("fitted"))


def hypothesis_reports(selection: Selection[FitT]) -> tuple[HypothesisReport, ...]:
    """The hypotheses of a model selection, the selected one first and the rest by their margin."""
    margins = {each.spec: each for each in selection.margins}
    contestants = {each.spec: each for each in selection.contestants}
    reports = []
    for spec in (selection.hypothesis, *margins) if contestants else ():
        margin = margins.get(spec)
        reports.append(
            HypothesisReport(
                described(spec),
                spec.kind,
                spec.light,
                tuple(round(value, 3) for value in contestants[spec].curve_db),
                contestants[spec].dropped,
                None if margin is None else round(margin.margin_db, 3),
                None if margin is None else round(margin.standard_error_db, 3),
            )
        )
    return tuple(reports)


def explanation_report(selection: Selection[FitT]) -> ExplanationReport | None:
    """The selected hypothesis beside the runner-up; None where nothing was compared."""
    if not selection.compared:
        return None
    chosen = described(selection.hypothesis)
    runner_up = selection.runner_up
    if runner_up is None:
        return ExplanationReport(
            chosen, sentence=f"{chosen}; the settings allow no other hypothesis, so none was compared"
        )
    name = described(runner_up.spec, beside=selection.hypothesis)
    side = "worse" if runner_up.margin_db >= 0 else "better, but less simple"
    return ExplanationReport(
        chosen,
        described(runner_up.spec),
        round(runner_up.margin_db, 3),
        round(runner_up.standard_error_db, 3),
        runner_up.held_out_views,
        selection.is_near_tie,
        f"{chosen}; next: {name}, {abs(runner_up.margin_db):.1f} ± {runner_up.standard_error_db:.1f} dB {side}",
    )


def near_tie_warning(selection: Selection[FitT]) -> str | None:
    """One sentence where the margin to the runner-up is within noise: it names the settings that force either."""
    first, second = selection.hypothesis, selection.runner_up
    if second is None or not selection.is_near_tie:
        return None
    return (
        f"held-out views hardly distinguish {described(first)} from {described(second.spec)} "
        f"({second.margin_db:+.1f} ± {second.standard_error_db:.1f} dB on {second.held_out_views} views); to force the "
        f"first: {forcing_settings(first)}; the second: {forcing_settings(second.spec)}"
    )


def comparison_reports(selection: Selection[FitT]) -> tuple[ComparisonReport, ...]:
    """The comparisons of a model selection for run.json."""
    return tuple(
        ComparisonReport(
            c.spec.name,
            c.spec,
            round(c.held_out_db, 3),
            round(c.gain_db, 3),
            round(c.standard_error_db, 3),
            c.held_out_views,
            c.accepted,
            is_within_noise(c.gain_db, c.standard_error_db, c.held_out_views),
        )
        for c in selection.comparisons
    )


def shape_report(selection: Selection[FitT]) -> ShapeReport | None:
    """The comparison of both shapes for run.json; None where there was one shape."""
    shape = selection.shape
    if shape is None:
        return None
    selected = "silhouettes alone" if shape.accepted else "silhouettes and photo-consistency"
    side = "worse" if (shape.gain_db >= 0) == shape.accepted else "better, within noise"
    other = "with photo-consistency" if shape.accepted else "silhouettes alone"
    sentence = f"{selected}; {other}: {abs(shape.gain_db):.1f} ± {shape.standard_error_db:.1f} dB {side}"
    return ShapeReport(**_figures(shape), sentence=sentence, silhouettes_selected=shape.accepted)


def _figures(shape: ShapeComparison[FitT]) -> dict[str, Any]:
    """Fields of an `OtherShapeReport` without its sentence."""
    views = len(shape.fit.errors)
    return {
        "held_out_db": tuple(round(value, 3) for value in shape.curve_db),
        "gain_db": round(shape.gain_db, 3),
        "standard_error_db": round(shape.standard_error_db, 3),
        "held_out_views": views,
        "near_tie": is_within_noise(shape.gain_db, shape.standard_error_db, views),
    }


def unchanged_mesh_report(comparison: ShapeComparison[FitT] | None, names: Sequence[str]) -> UnchangedMeshReport | None:
    """The comparison with the mesh without what these initializers changed; None where there was none."""
    if comparison is None:
        return None
    changed = " and ".join(names)
    kept = f"what {changed} changed is {'left out' if comparison.accepted else 'kept'}"
    side = "worse" if (comparison.gain_db >= 0) == comparison.accepted else "better, within noise"
    other = "with it" if comparison.accepted else "without it"
    sentence = f"{kept}; {other}: {abs(comparison.gain_db):.1f} ± {comparison.standard_error_db:.1f} dB {side}"
    return UnchangedMeshReport(
        **_figures(comparison), sentence=sentence, initializers=tuple(names), selected=comparison.accepted
    )


def lamp_report(selection: Selection[FitT]) -> LampReport | None:
    """The short comparison with a lamp for run.json; None where there was none."""
    lamp = selection.lamp
    if lamp is None:
        return None
    return LampReport(
        lamp.takes_part,
        described(lamp.nearest),
        round(lamp.gain_db, 3),
        round(lamp.standard_error_db, 3),
        lamp.held_out_views,
        is_within_noise(lamp.gain_db, lamp.standard_error_db, lamp.held_out_views),
    )


def exposure_report(selection: ExposureSelection, used: PhotographExposures, capture: Capture) -> ExposureReport | None:
    """How the exposures of photographs differ; None where they are equal. `capture` as the fit saw it."""
    if used.kind == "equal":
        return None
    stops = np.log2(np.array(list(used.factors.values())))
    brightness, balance = float(np.ptp(stops[:, 1])), float(np.ptp(stops[:, [0, 2]] - stops[:, 1:2], axis=0).max())
    words = {"recorded": "as EXIF data record them", "fitted": "fitted for each photograph"}[used.kind]
    sentence = f"{words}: brightness differs by {brightness:.2f} stops, white balance by {balance:.2f}"
    gain, error, views = selection.gain_db, selection.standard_error_db, selection.held_out_views
    near_tie = None
    if gain is not None and error is not None and views is not None:
        near_tie = is_within_noise(gain, error, views)
        sentence += f"; with {selection.before} exposures: {gain:.1f} ± {error:.1f} dB worse"
    response = None
    if used.kind == "fitted":
        response = camera_response(used.factors, capture.views)
    return ExposureReport(
        used.kind,
        round(brightness, 3),
        round(balance, 3),
        {name: (round(r, 4), round(g, 4), round(b, 4)) for name, (r, g, b) in used.factors.items()},
        selection.before,
        None if gain is None else round(gain, 3),
        None if error is None else round(error, 3),
        views,
        near_tie,
        sentence,
        response,
    )


def significant(value: float) -> float:
    """A number rounded to 4 significant digits."""
    return float(f"{value:.4g}")


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }
