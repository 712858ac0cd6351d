"""Refinements of the selected hypothesis: which are accepted, and against which control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.plugins.progress import MODEL_FITTED, MODELS_COMPARED
from hir_core.report.convergence import milestones
from hir_core.run.progress_listener import ProgressListener
from hir_core.run.stage_context import StageContext
from hir_core.stages.reflectance.reflectance_report import explanation_report
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.held_out_comparison import is_refined
from hir_core.stages.reflectance.selection.hypotheses import INTERREFLECTIONS
from hir_core.stages.reflectance.selection.model_selection import select_model
from hir_core.stages.reflectance.selection.requested_model import forced_spec
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS
from hir_core.stages.reflectance.stage_progress import StageProgress
from tests.hir_core.stages.reflectance.selection.scripted_solver import Fit, Recorder, Scripted, chosen, level, select


def test_more_steps_alone_are_no_gain() -> None:
    """Fits that improve with every step alike accept no refinement."""
    selection = select(
        Scripted(lambda spec, effort: level(20 + 5 * effort - 9 * (spec.kind != "dielectric"))),
        ReflectanceSettings(light_frame="world"),
    )
    assert selection.spec == ModelSpec("dielectric", "uniform")


@pytest.mark.parametrize(("decibels", "gain", "refined"), [(24, 0.3, True), (40, 0.3, False), (40, 0.6, True)])
def test_near_the_photographs_a_refinement_must_gain_more(decibels: float, gain: float, refined: bool) -> None:
    """The same gain in dB is a smaller change of the picture: 0.6, 0.09 and 0.17 steps of 8 bits."""
    views = 10 ** (-0.01 * np.arange(8))
    before, after = (views * 10 ** (-value / 10) for value in (decibels, decibels + gain))
    assert is_refined(before, after) is refined
    assert not is_refined(after, before)
    doubtful = before * np.where(np.arange(8) % 2, 10**-0.3, 10**0.2)
    assert not is_refined(before, doubtful), "a gain on half of the views is not significant"


def test_one_control_serves_all_comparisons_until_a_candidate_is_accepted() -> None:
    solver = Scripted(lambda spec: level(30 if spec.kind == "dielectric" and spec.bounces else 10))
    spec = select(solver, ReflectanceSettings(light_frame="world")).spec
    again = [each for each, _ in solver.fitted].count(spec)
    assert again == len(ROUNDS) + 1, "once in each round, once as the control of four refinements"


@pytest.mark.parametrize("settings", [{}, {"model": "normal_map"}, {"brdf": "paper", "light_frame": "world"}], ids=str)
@pytest.mark.parametrize("better", ["nothing", "a lobe", "everything but the camera's light"])
def test_progress_rises_to_the_end(better: str, settings: dict[str, Any]) -> None:
    def error(spec: ModelSpec) -> float:
        if spec.light_frame == "camera" or better == "nothing":
            return 1e-2
        more = spec.brdf != "diffuse"
        if better != "a lobe":
            more += spec.colored + (spec.specular, spec.roughness, spec.normals).count("map")
        return 1e-2 * 0.3**more

    recorder = Recorder()
    selection = select(Scripted(error), ReflectanceSettings(**settings), 48, recorder)
    assert recorder.shares == sorted(recorder.shares) and recorder.shares[0] > 0 and recorder.shares[-1] <= 1
    assert recorder.shares[-1] > 0.7, "the expected cost is near the true one"
    assert recorder.comparisons == list(selection.comparisons)


@pytest.mark.parametrize("best", ["diffuse", "dielectric"])
def test_progress_neither_stands_still_nor_jumps_where_hypotheses_are_dropped(best: str) -> None:
    """Dropped hypotheses and accepted refinements change the expected cost; every fit moves the bar all the same."""

    def error(spec: ModelSpec) -> float:
        maps = (spec.specular, spec.roughness).count("map")
        return level(34 + 4 * (spec.kind == best) - 14 * (spec.light_frame == "camera") + maps + (spec.bounces > 0))

    recorder = Recorder()
    select(Scripted(error), ReflectanceSettings(), 48, recorder)
    ended = recorder.shares[2::3]  # a scripted fit reports its beginning, half of it and its end
    steps = np.diff([0.0, *ended])
    assert (steps > 0.005).all() and steps.max() < 0.3


@pytest.mark.parametrize(
    "truth",
    [
        ModelSpec(),
        ModelSpec(bounces=INTERREFLECTIONS),
        ModelSpec("dielectric", "uniform"),
        ModelSpec("dielectric", "map"),
        ModelSpec("dielectric", "uniform", "map"),
        ModelSpec("dielectric", "map", "map", bounces=INTERREFLECTIONS),
        ModelSpec("dielectric", "uniform", light_frame="camera"),
        ModelSpec("metallic", "uniform", metalness="metal", bounces=INTERREFLECTIONS),
        ModelSpec("metallic", "uniform", "map", metalness="map"),
        ModelSpec("dielectric", "uniform", normals="map"),
        ModelSpec(bounces=INTERREFLECTIONS, normals="map"),
        ModelSpec("dielectric", "uniform", per_texel="brdf"),
        ModelSpec("metallic", "uniform", metalness="metal", per_texel="brdf"),
    ],
    ids=lambda spec: spec.name,
)
def test_the_true_model_is_selected(truth: ModelSpec) -> None:
    def error(spec: ModelSpec) -> float:
        wrong = (
            spec.kind == truth.kind,
            spec.specular == truth.specular or spec.kind != truth.kind,
            spec.roughness == truth.roughness,
            spec.bounces == truth.bounces,
            spec.light_frame == truth.light_frame,
            spec.normals == truth.normals,
            (spec.per_texel == "brdf") == (truth.per_texel == "brdf"),
        )
        return 1e-3 * 2.0 ** (wrong.count(False) + (spec.kind != truth.kind))

    assert chosen(error) == truth


@pytest.mark.parametrize("colored", [False, True])
def test_paper_is_fitted_by_request(colored: bool) -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 * (1 if spec.colored == colored else 2)

    assert chosen(error, brdf="paper") == ModelSpec("paper", "uniform", colored=colored)


def test_a_gain_within_its_standard_error_is_rejected() -> None:
    def error(spec: ModelSpec) -> float:
        return 0.97e-3 if spec.normals == "map" else 1e-3

    assert chosen(error, brdf="dielectric").normals == "map", "the same gain without noise is accepted"
    assert chosen(error, noise=1.0, brdf="dielectric").normals == "mesh"


def test_a_fit_within_one_step_of_eight_bits_is_sufficient() -> None:
    def twice_as_good(spec: ModelSpec) -> float:
        return 1.0 if spec.kind == "diffuse" and spec.normals == "mesh" else 0.5

    assert chosen(lambda spec: (1.2 / 255) ** 2 * twice_as_good(spec)) != ModelSpec()
    assert chosen(lambda spec: (0.9 / 255) ** 2 * twice_as_good(spec)) == ModelSpec()


def test_no_normal_map_under_a_light_on_the_camera() -> None:
    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.normals == "map" else 3e-3) * (1 if spec.light_frame == "camera" else 5)

    assert chosen(error) == ModelSpec(light_frame="camera")
    for model in ("normal_map", "per_texel_brdf"):
        with pytest.raises(ConfigError, match="fixed in the world"):
            forced_spec(ReflectanceSettings(model=model, light_frame="camera"))


@pytest.mark.parametrize("gain", [2.0, 0.3])
def test_a_rival_under_a_light_in_the_world_has_its_normals_before_it_is_compared(gain: float) -> None:
    """A light on the camera imitates relief, for which it has no normals of its own."""

    def error(spec: ModelSpec) -> float:
        camera = spec.light_frame == "camera"
        return level(25 + camera + gain * (spec.normals == "map") - 9 * (spec.kind != "diffuse"))

    expected = ModelSpec(normals="map", bounces=INTERREFLECTIONS) if gain > 1 else ModelSpec(light_frame="camera")
    assert replace(chosen(error), bounces=expected.bounces) == expected


@pytest.mark.parametrize("gain", [3.0, 0.5])
def test_a_light_on_the_camera_yields_to_a_rival_whose_texels_gain_more_than_it_lacks(gain: float) -> None:
    """A per-texel albedo alone fits 4 dB better than vertices; that says nothing about the light."""

    def error(spec: ModelSpec) -> float:
        own = {"none": 0.0, "albedo": 4.0, "brdf": 4.0 + gain}[spec.per_texel]
        kind = {"diffuse": 0.5, "dielectric": 1.0, "metal": -9.0, "mixed": -9.0}[spec.kind]
        return level(25 + (spec.light_frame == "camera") + kind + own)

    selection = select(Scripted(error, noise=0.01), ReflectanceSettings())
    last = selection.comparisons[-1]
    assert last.spec.per_texel == "brdf" and last.spec.light_frame == "world"
    assert last.gain_db == pytest.approx(gain - 1, abs=0.05) and last.accepted == (gain > 1)
    if gain > 1:
        assert selection.spec == last.spec and selection.hypothesis.light_frame == "world"
        report = explanation_report(selection)
        assert report is not None and report.margin_db is not None and report.margin_db > 0
    else:
        assert selection.spec.light_frame == "camera" and selection.spec.per_texel == "none"


def test_the_map_that_gains_most_is_selected_first() -> None:
    """A specular map imitates a roughness map. It gains, and is compared before; but it is not what is there."""

    def error(spec: ModelSpec) -> float:
        return level(20 + (3 if spec.roughness == "map" else 1.5 if spec.specular == "map" else 0))

    settings = ReflectanceSettings(brdf="dielectric", light_frame="world")
    selection = select(Scripted(error), settings)
    assert (selection.spec.specular, selection.spec.roughness) == ("uniform", "map")
    first, second, again, _ = (
        each
        for each in selection.comparisons
        if "map" in (each.spec.specular, each.spec.roughness) and each.spec.per_texel == "none"
    )
    assert not first.accepted and second.accepted and not again.accepted
    assert again.spec == replace(selection.spec, specular="map"), "what is left is compared with the new model"


@pytest.mark.parametrize(("gain", "accepted"), [(0.2, False), (0.4, True)])
@pytest.mark.parametrize("part", ["roughness", "specular"])
def test_a_roughness_map_needs_more_gain_than_other_maps(part: str, gain: float, accepted: bool) -> None:
    def error(spec: ModelSpec) -> float:
        return level(20 + (gain if getattr(spec, part) == "map" else 0))

    selection = select(Scripted(error), ReflectanceSettings(brdf="dielectric", light_frame="world"))
    assert (getattr(selection.spec, part) == "map") == (accepted or part == "specular")


def test_no_per_texel_brdf_after_maps_of_the_lobe_at_vertices() -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 * 0.5 ** sum([spec.brdf == "dielectric", spec.roughness == "map", spec.per_texel == "brdf"])

    assert chosen(error) == ModelSpec("dielectric", "uniform", roughness="map")


@pytest.mark.parametrize("gain", [2, 0])
def test_a_normal_map_yields_to_a_per_texel_brdf_that_gains_more(gain: int) -> None:
    """Texels have normals of their own, in place of the map's."""

    def error(spec: ModelSpec) -> float:
        own = {"none": int(spec.normals == "map"), "albedo": 0, "brdf": gain}[spec.per_texel]
        return 1e-3 * 0.5 ** (own + (spec.brdf == "dielectric"))

    normals, texels = (
        ModelSpec("dielectric", "uniform", normals="map"),
        ModelSpec("dielectric", "uniform", per_texel="brdf"),
    )
    assert chosen(error) == (texels if gain else normals)


def test_a_per_texel_brdf_behind_the_model_that_it_would_replace_is_rejected() -> None:
    """As on a mirror: lobes of texels are never narrow enough, with their own albedo alone and with a BRDF."""

    def error(spec: ModelSpec) -> float:
        at_texels = {"none": 1.0, "albedo": 12.0, "brdf": 8.0}[spec.per_texel]
        return 1e-4 * at_texels * (1 if spec.brdf == "dielectric" else 3)

    selection = select(Scripted(error), ReflectanceSettings())
    last = selection.comparisons[-1]
    assert last.spec.per_texel == "brdf" and not last.accepted
    assert last.gain_db == pytest.approx(-10 * np.log10(8)), "the reason: against the model, not against the albedo"
    assert selection.spec.per_texel == "none"


def test_per_texel_brdf_is_compared_with_per_texel_albedo() -> None:
    """Points with their own albedo fit better than vertices, whatever the lobe: that is not a gain of the lobe."""

    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.per_texel == "none" else 0.2e-3) * (1 if spec.brdf == "dielectric" else 3)

    selection = select(Scripted(error), ReflectanceSettings())
    assert selection.spec == ModelSpec("dielectric", "uniform")
    last = selection.comparisons[-1]
    assert not last.accepted and last.spec.per_texel == "brdf" and last.gain_db == pytest.approx(0)


class ScriptedTexels(Scripted):
    """A per-texel BRDF gains 0.6 dB on the first held-out views, half of them more and half less by `deviation` dB, and
    `later` dB on others.
    """

    def __init__(self, deviation: float, later: float) -> None:
        super().__init__(lambda spec: level(30 if spec.kind == "dielectric" else 20))
        self._deviation, self._later = deviation, later
        self.first: set[int] = set()

    def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
        self.first = self.first or set(views)
        errors = super().errors(fit, views)
        if fit.spec.per_texel != "brdf":
            return errors
        gain = 0.6 if set(views) == self.first else self._later
        return errors * 10 ** (-0.1 * (gain + self._deviation * (-1) ** np.arange(len(views))))


@pytest.mark.parametrize(
    ("deviation", "later", "views", "accepted"),
    [(0.65, 0.8, 12, True), (0.65, -0.6, 12, False), (0.1, -0.6, 6, True), (2.0, 0.8, 6, False)],
)
def test_a_doubtful_gain_of_texels_is_measured_on_more_views(
    deviation: float, later: float, views: int, accepted: bool
) -> None:
    """0.6 ± 0.3 dB exceeds one standard error, not two."""
    solver, recorder = ScriptedTexels(deviation, later), Recorder()
    selection = select(solver, ReflectanceSettings(light_frame="world"), 48, recorder)
    last = selection.comparisons[-1]
    assert last.spec.per_texel == "brdf" and (last.held_out_views, last.accepted) == (views, accepted)
    assert last.gain_db == pytest.approx(0.6 if views == 6 else (0.6 + later) / 2)
    assert (selection.spec.per_texel == "brdf") == accepted
    assert selection.held_out_errors is not None
    assert len(selection.held_out_errors) == 6, "a comparison with another mesh is on the same views"
    assert recorder.shares == sorted(recorder.shares) and recorder.shares[-1] <= 1


def test_comparisons_are_timed_when_they_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit reports nothing before its first step; that time counts as its own."""
    now = [0.0]
    monkeypatch.setattr("hir_core.run.progress_listener.time.perf_counter", lambda: now[0])

    class Slow(Scripted):
        def fit(self, spec: ModelSpec, *others: Any) -> Any:
            now[0] += 10 + len(self.fitted)
            return super().fit(spec, *others)

    listener = ProgressListener("reflectance", PluginManager(), None)
    bar = StageProgress(StageContext(PluginManager(), tmp_path, {}, report=listener.report))
    solver = Slow(lambda spec: 1e-3 if spec.bounces else 1e-2)
    settings = ReflectanceSettings(brdf="dielectric", light_frame="world")
    selection = select_model(FitSequence(solver, bar.selecting), settings, 48, bar)
    ended = np.cumsum([10 + number for number in range(len(solver.fitted))])
    timings = {"stages": {"reflectance": {"milestones": listener.milestones}}}
    assert milestones(timings, MODEL_FITTED) == ended[:-2].tolist(), "per-texel models are compared, not fitted"
    # three rounds, then control and no indirect light, specular and roughness map together, normals, per-texel models
    assert milestones(timings, MODELS_COMPARED) == ended[[4, 6, 6, 7, 9]].tolist()
    assert len(selection.comparisons) == 5


# -- views ----------------------------------------------------------------------------------------------------------
