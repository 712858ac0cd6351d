"""Model selection: which hypotheses and refinements are selected, and which views decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from hir_core.config import ModelName, ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.interfaces import CheckpointLocation, ReflectanceSolver
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.plugins.progress import MODEL_FITTED, MODELS_COMPARED
from hir_core.report.convergence import milestones
from hir_core.run.progress_listener import ProgressListener
from hir_core.run.stage_context import StageContext
from hir_core.stages.held_out_views import held_out_for_model_selection, model_selection_folds
from hir_core.stages.reflectance.fit_sequence import FitSequence
from hir_core.stages.reflectance.held_out_comparison import critical_value, decibels, paired_gain
from hir_core.stages.reflectance.hypotheses import INTERREFLECTIONS, contains, forcing_settings, hypotheses, hypothesis
from hir_core.stages.reflectance.model_selection import Selection, select_model
from hir_core.stages.reflectance.refinement_selection import Comparison
from hir_core.stages.reflectance.reflectance_report import (
    explanation_report,
    hypothesis_reports,
    near_tie_warning,
)
from hir_core.stages.reflectance.requested_model import forced_spec
from hir_core.stages.reflectance.stage_progress import StageProgress
from hir_core.stages.reflectance.successive_halving import ROUNDS

TOTAL = sum(budget.effort for budget in ROUNDS)


class Fit:
    """A model, the effort spent on it, and the views it was fitted to."""

    def __init__(self, spec: ModelSpec, effort: float, views: tuple[int, ...]) -> None:
        self.spec, self.effort, self.views = spec, effort, views


Error = Callable[[ModelSpec, float], float]
"""Mean squared error of a model after an effort."""


class Scripted(ReflectanceSolver[Fit, None]):
    """A solver whose held-out error is a function of the model and the effort."""

    def __init__(self, error: Error | Callable[[ModelSpec], float], noise: float = 0.0, seed: int = 0) -> None:
        self._error = error
        self._noise = noise
        self._seed = seed
        self.fitted: list[tuple[ModelSpec, tuple[int, ...]]] = []
        self.budgets: list[tuple[ModelSpec, float, float]] = []
        self.checkpoints: list[CheckpointLocation | None] = []

    def fit(
        self,
        spec: ModelSpec,
        initial: Fit | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None = None,
        pixel_share: float = 1.0,
    ) -> Fit:
        assert initial is None or initial.views == tuple(views), "a fit of one fold must not continue another's"
        self.fitted.append((spec, tuple(views)))
        self.budgets.append((spec, effort, pixel_share))
        self.checkpoints.append(checkpoint)
        for share in (0.01, 0.5, 1.0):
            report(share)
        return Fit(spec, effort + (initial.effort if initial else 0.0), tuple(views))

    def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
        assert set(fit.views).isdisjoint(views)
        try:
            error = self._error(fit.spec, fit.effort)  # type: ignore[call-arg]
        except TypeError:
            error = self._error(fit.spec)  # type: ignore[call-arg]
        rng = np.random.default_rng((self._seed, len(fit.spec.name)))
        noise = rng.normal(0, self._noise, 1000)[list(views)]
        return error * np.exp(noise)

    def scene(self, fit: Any, views: Sequence[int], report: Callable[[float], None]) -> Any:
        raise AssertionError("model selection needs no textures")

    def radiance(self, material: Any, environment: Any, pixels: Any) -> Any:
        raise AssertionError("model selection needs no radiance")


class Recorder:
    """Records the progress of a model selection."""

    def __init__(self) -> None:
        self.shares: list[float] = []
        self.comparisons: list[Comparison] = []

    def progress(self, name: str, share: float) -> None:
        self.shares.append(share)

    def evaluated(self, held_out_db: float) -> None:
        assert held_out_db <= 120

    def compared(self, comparison: Comparison) -> None:
        self.comparisons.append(comparison)


def select(
    solver: Scripted, settings: ReflectanceSettings, views: int = 48, recorder: Recorder | None = None
) -> Selection[Fit]:
    recorder = recorder or Recorder()
    return select_model(FitSequence(solver, recorder.progress), settings, views, recorder)


def chosen(error: Callable[..., float], noise: float = 0.0, views: int = 48, **settings: Any) -> ModelSpec:
    return select(Scripted(error, noise), ReflectanceSettings(**settings), views).spec


def level(db: float) -> float:
    """The mean squared error of a PSNR."""
    return float(10 ** (-db / 10))


# -- hypotheses -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["diffuse", "dielectric", "metal", "mixed"])
@pytest.mark.parametrize("frame", ["world", "camera"])
def test_the_true_hypothesis_is_selected(kind: Any, frame: Any) -> None:
    def error(spec: ModelSpec, effort: float) -> float:
        wrong = (spec.kind != kind) + 2 * (spec.light_frame != frame)
        return level(20 + 8 * (1 - 0.1**effort) - 3 * wrong)

    selection = select(Scripted(error, noise=0.1), ReflectanceSettings())
    assert selection.hypothesis.kind == kind and selection.hypothesis.light_frame == frame
    report = explanation_report(selection)
    assert report is not None and report.margin_db == pytest.approx(3, abs=0.3) and not report.near_tie
    assert near_tie_warning(selection) is None


def test_curves_that_cross_are_fitted_to_their_end() -> None:
    """A metal's initial guess is ahead by 5 dB after the first round; the dielectric ends 3 dB above it."""
    curves = {"diffuse": [15.0, 16.0, 16.5], "dielectric": [16.0, 20.0, 26.0], "metal": [21.4, 22.5, 23.0]}

    def error(spec: ModelSpec, effort: float) -> float:
        efforts = np.cumsum([budget.effort for budget in ROUNDS])
        curve = curves.get(spec.kind, [10.0, 10.5, 11.0])
        return level(float(np.interp(effort, efforts, curve)) - 4 * (spec.light_frame == "camera"))

    selection = select(Scripted(error, noise=0.05), ReflectanceSettings())
    assert selection.hypothesis.kind == "dielectric"
    rounds = {(each.spec.kind, each.spec.light_frame): len(each.rounds) for each in selection.contestants}
    assert rounds["dielectric", "world"] == rounds["metal", "world"] == 3
    assert rounds["mixed", "camera"] < 3, "a curve that cannot reach the best one gets no full budget"
    report = explanation_report(selection)
    assert report is not None and report.sentence.startswith("dielectric, light in the world; next: metal, ")
    assert report.margin_db == pytest.approx(3, abs=0.2)


def test_budgets_are_continued() -> None:
    solver = Scripted(lambda spec: level(20))
    selection = select(solver, ReflectanceSettings(light_frame="world", brdf="metallic", metalness="metal"))
    assert selection.contestants[0].last.fits[0].effort == pytest.approx(TOTAL)
    budgets = [(effort, share) for spec, effort, share in solver.budgets][: len(ROUNDS)]
    assert budgets == [(budget.effort, budget.pixel_share) for budget in ROUNDS]
    assert all(before.pixel_share <= after.pixel_share for before, after in pairwise(ROUNDS))


def test_hypotheses_are_compared_after_equally_many_steps() -> None:
    """A solver that fits diffuse before dielectric and metal before mixed: none of them wins by the steps of both."""

    class Chained(Scripted):
        def simpler(self, spec: ModelSpec) -> ModelSpec | None:
            before = {"dielectric": "diffuse", "mixed": "metal"}.get(spec.kind)
            return None if before is None else hypothesis(before, spec.light_frame)  # type: ignore[arg-type]

        def fit(self, spec: ModelSpec, initial: Fit | None, *arguments: Any, **others: Any) -> Fit:
            simpler = self.simpler(spec)
            if initial is None and simpler is not None:
                initial = self.fit(simpler, None, *arguments, **others)
            return super().fit(spec, initial, *arguments, **others)

    chosen = select(Chained(lambda spec, effort: 0.01 * 0.5**effort), ReflectanceSettings(light_frame="world"))
    assert chosen.hypothesis.kind == "diffuse"
    assert len({len(each.rounds) for each in chosen.contestants}) == 1
    assert all(margin.margin_db == 0 for margin in chosen.margins), chosen.margins


def test_a_tie_goes_to_the_simpler_hypothesis() -> None:
    def error(spec: ModelSpec) -> float:
        return level(30 + 0.05 * (spec.kind == "metal") + 0.03 * (spec.light_frame == "camera"))

    selection = select(Scripted(error, noise=0.005), ReflectanceSettings())
    assert selection.hypothesis == hypothesis("diffuse", "world")
    assert selection.spec == ModelSpec(), "and without indirect light, which gains nothing"
    report, warning = explanation_report(selection), near_tie_warning(selection)
    assert report is not None and report.near_tie and "better, but less simple" in report.sentence
    assert warning is not None and warning.count("--set reflectance.light_frame=") == 2
    assert "--set reflectance.model=diffuse --set reflectance.light_frame=world" in warning


def test_a_near_tie_is_judged_by_a_second_fold() -> None:
    """Both finalists are fitted again without the second fold's views; a clear case costs nothing more."""
    folds = model_selection_folds(48)

    def error(gap: float) -> Callable[[ModelSpec], float]:
        return lambda spec: level(30 - gap * (spec.kind != "diffuse"))

    trained = {}
    for gap in (0.0, 3.0):
        solver = Scripted(error(gap))
        select(solver, ReflectanceSettings(light_frame="world"))
        trained[gap] = {views for _, views in solver.fitted}
    assert trained[3.0] == {tuple(folds[0][0])}
    assert trained[0.0] == {tuple(folds[0][0]), tuple(folds[1][0])}


def test_noise_does_not_choose_between_equal_hypotheses() -> None:
    """Whatever the seed, a difference that is noise selects the simplest one in most draws; all are near ties."""
    specs = [
        select(Scripted(lambda spec: level(30), 0.2, seed), ReflectanceSettings(light_frame="world"), 48).hypothesis
        for seed in range(20)
    ]
    assert [spec.kind for spec in specs].count("diffuse") >= 12


def test_gains_that_differ_between_views_are_gains() -> None:
    """Half of the views see metal and gain 9 dB, half see plastic and gain little: the mean is uncertain, not zero."""

    class TwoMaterials(Scripted):
        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            errors = super().errors(fit, views)
            plastic = np.array([number % 2 for number in range(len(views))])
            return np.asarray(errors * np.where(plastic, 1.0, level(9.0 * (fit.spec.kind == "mixed"))))

    selection = select(TwoMaterials(lambda spec: level(25), noise=0.05), ReflectanceSettings(light_frame="world"))
    assert selection.hypothesis.kind == "mixed"


def test_a_runner_up_gets_the_refinements_of_the_selected_one() -> None:
    """Mixed without maps is ahead of a dielectric, whose specular map explains as much."""

    def error(spec: ModelSpec) -> float:
        gain = {"diffuse": 0.0, "dielectric": 4.0, "metal": 1.0, "mixed": 4.8}[spec.kind]
        return level(25 + gain + 0.8 * (spec.specular == "map"))

    selection = select(Scripted(error, noise=0.01), ReflectanceSettings(light_frame="world"))
    assert selection.spec == ModelSpec("dielectric", "map")
    assert selection.hypothesis.kind == "dielectric"
    assert [each.spec.kind for each in selection.comparisons].count("dielectric") == 1


@pytest.mark.parametrize(
    "settings,kinds,frames",
    [
        ({}, 4, ("world", "camera")),
        ({"light_frame": "camera"}, 4, ("camera",)),
        ({"brdf": "metallic"}, 2, ("world", "camera")),
        ({"brdf": "metallic", "metalness": "metal"}, 1, ("world", "camera")),
        ({"brdf": "paper", "light_frame": "world"}, 1, ("world",)),
        ({"known_environment": "light.hdr"}, 4, ("world",)),
    ],
    ids=str,
)
def test_settings_restrict_the_hypotheses(settings: dict[str, Any], kinds: int, frames: tuple[str, ...]) -> None:
    specs = hypotheses(ReflectanceSettings(**settings))
    assert len(specs) == kinds * len(frames) and {spec.light_frame for spec in specs} == set(frames)
    assert all(spec.light_is_known == bool(settings.get("known_environment")) for spec in specs)
    if "brdf" in settings:
        assert {spec.brdf for spec in specs} == {settings["brdf"]}


def test_a_hypothesis_that_contains_the_selected_one_is_no_runner_up() -> None:
    """Metal with a map of metalness explains every metal."""

    def error(spec: ModelSpec) -> float:
        return level(30 - 3 * (spec.kind not in ("metal", "mixed")) - 9 * (spec.light_frame == "camera"))

    selection = select(Scripted(error, noise=0.01), ReflectanceSettings())
    report = explanation_report(selection)
    assert report is not None and report.sentence.startswith("metal, light in the world; next: ")
    assert report.runner_up in ("dielectric, light in the world", "diffuse, light in the world")
    assert report.margin_db == pytest.approx(3, abs=0.1) and not report.near_tie
    assert near_tie_warning(selection) is None
    only = select(Scripted(error), ReflectanceSettings(brdf="metallic", light_frame="world"))
    report = explanation_report(only)
    assert report is not None and report.runner_up == "mixed, light in the world" and not report.near_tie
    mixed = hypothesis("mixed")
    assert [contains(mixed, hypothesis(kind)) for kind in ("diffuse", "dielectric", "metal", "mixed")] == [1, 1, 1, 0]
    assert not contains(mixed, hypothesis("metal", "camera")) and not contains(hypothesis("metal"), mixed)


def test_one_hypothesis_has_no_runner_up() -> None:
    selection = select(
        Scripted(lambda spec: level(30)), ReflectanceSettings(light_frame="world", brdf="metallic", metalness="map")
    )
    report = explanation_report(selection)
    assert report is not None and report.runner_up is None and near_tie_warning(selection) is None


def test_run_json_names_every_hypothesis() -> None:
    def error(spec: ModelSpec) -> float:
        return level(30 - 9 * (spec.kind != "metal") - 9 * (spec.light_frame == "camera"))

    reports = hypothesis_reports(select(Scripted(error), ReflectanceSettings()))
    assert len(reports) == 8 and reports[0].hypothesis == "metal, light in the world"
    assert reports[0].margin_db is None and len(reports[0].held_out_db) == len(ROUNDS)
    order = [(-len(each.held_out_db), each.margin_db) for each in reports[1:]]
    assert order == sorted(order) and len(order) == 7, "those that were fitted longest first"
    assert any(each.dropped for each in reports)


# -- refinements ----------------------------------------------------------------------------------------------------


def test_more_steps_alone_are_no_gain() -> None:
    """Fits that improve with every step alike accept no refinement."""
    selection = select(
        Scripted(lambda spec, effort: level(20 + 5 * effort - 9 * (spec.kind != "dielectric"))),
        ReflectanceSettings(light_frame="world"),
    )
    assert selection.spec == ModelSpec("dielectric", "uniform")


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


def test_the_map_that_gains_most_is_selected_first() -> None:
    """A specular map imitates a roughness map. It gains, and is compared before; but it is not what is there."""

    def error(spec: ModelSpec) -> float:
        return level(20 + (3 if spec.roughness == "map" else 1.5 if spec.specular == "map" else 0))

    settings = ReflectanceSettings(brdf="dielectric", light_frame="world")
    selection = select(Scripted(error), settings)
    assert (selection.spec.specular, selection.spec.roughness) == ("uniform", "map")
    first, second, again, _ = (
        each for each in selection.comparisons if "map" in (each.spec.specular, each.spec.roughness)
    )
    assert not first.accepted and second.accepted and not again.accepted
    assert again.spec == replace(selection.spec, specular="map"), "what is left is compared with the new model"


def test_no_per_texel_brdf_after_maps_at_vertices() -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 * 0.5 ** sum([spec.brdf == "dielectric", spec.normals == "map", spec.per_texel == "brdf"])

    assert chosen(error) == ModelSpec("dielectric", "uniform", normals="map")


def test_per_texel_brdf_is_compared_with_per_texel_albedo() -> None:
    """Points with their own albedo fit better than vertices, whatever the lobe: that is not a gain of the lobe."""

    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.per_texel == "none" else 0.2e-3) * (1 if spec.brdf == "dielectric" else 3)

    selection = select(Scripted(error), ReflectanceSettings())
    assert selection.spec == ModelSpec("dielectric", "uniform")
    last = selection.comparisons[-1]
    assert not last.accepted and last.spec.per_texel == "brdf" and last.gain_db == pytest.approx(0)


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


def test_held_out_views_are_never_fitted() -> None:
    """`Scripted.errors` asserts it for every fold."""
    solver = Scripted(lambda spec: 1e-3)
    select(solver, ReflectanceSettings(), 24)
    assert {views for _, views in solver.fitted} <= {tuple(training) for training, _ in model_selection_folds(24)}


@pytest.mark.parametrize("views", [*range(6, 60), 100])
def test_at_least_six_views_judge(views: int) -> None:
    folds = model_selection_folds(views)
    first, second = (held_out for _, held_out in folds)
    assert not set(first) & set(second) and len(first) == len(second)
    for training, held_out in folds:
        assert sorted(training + held_out) == list(range(views)) and len(training) >= len(held_out)
    assert len(first) == views // 8 if views >= 48 else len(first) == 6 or len(first) + len(second) >= 6
    assert held_out_for_model_selection(views) == folds[0]


@pytest.mark.parametrize("views", [6, 7, 11, 12, 30])
def test_few_views_are_enough_for_a_selection(views: int) -> None:
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "diffuse" else 1e-4, noise=0.1)
    selection = select(solver, ReflectanceSettings(light_frame="world"), views)
    assert selection.spec.brdf != "diffuse"
    assert len(selection.contestants[0].last.errors) >= 6


@pytest.mark.parametrize("views", [1, 3])
def test_too_few_views_fit_the_default_model(views: int) -> None:
    solver = Scripted(lambda spec: 1e-3)
    selection = select(solver, ReflectanceSettings(), views)
    assert selection.spec == ModelSpec("dielectric", "uniform") and not selection.compared
    assert explanation_report(selection) is None and near_tie_warning(selection) is None
    assert solver.fitted == [(selection.spec, tuple(range(views)))]


def test_a_named_model_is_fitted_without_a_comparison() -> None:
    assert chosen(lambda spec: 1e-3, model="roughness_map", brdf="paper") == ModelSpec("paper", "map", "map")
    metal = ModelSpec("metallic", "uniform", "map", metalness="metal")
    assert chosen(lambda spec: 1e-3, model="roughness_map", brdf="metallic", metalness="metal") == metal


@pytest.mark.parametrize("name", [name for name in get_args(ModelName) if name != "auto"])
def test_every_model_name_has_a_spec(name: ModelName) -> None:
    assert forced_spec(ReflectanceSettings(model=name)) is not None


def test_a_specular_map_of_a_metallic_model_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"does not go with reflectance\.brdf=metallic"):
        forced_spec(ReflectanceSettings(model="specular_map", brdf="metallic"))


@pytest.mark.parametrize("frame", ["world", "camera"])
@pytest.mark.parametrize("kind", ["diffuse", "dielectric", "metal", "mixed"])
def test_the_settings_that_a_warning_names_leave_one_hypothesis(kind: Any, frame: Any) -> None:
    spec = hypothesis(kind, frame)
    pairs = [text.strip().split("=") for text in forcing_settings(spec).split("--set") if text.strip()]
    settings = ReflectanceSettings(**{key.removeprefix("reflectance."): value for key, value in pairs})
    forced = forced_spec(settings)
    admitted = [forced] if forced is not None else hypotheses(settings)
    assert [replace(each, bounces=0) for each in admitted] == [replace(spec, bounces=0)]


# -- statistics -----------------------------------------------------------------------------------------------------


def test_comparison_is_paired() -> None:
    hard_and_easy = np.array([1e-1, 1e-4, 1e-2])
    gain, noise = paired_gain(hard_and_easy, hard_and_easy / 10)
    assert gain == pytest.approx(10)
    assert noise == pytest.approx(0, abs=1e-9)


def test_few_views_need_larger_gains() -> None:
    """Student's t: with six views, a gain of noise alone exceeds the critical value as often as a normal one does."""
    noise = decibels(np.exp(np.random.default_rng(1).normal(0, 0.1, (20_000, 6))))
    ratio = noise.mean(axis=1) / (noise.std(axis=1, ddof=1) / np.sqrt(6))
    assert np.mean(ratio > critical_value(1.0, 6)) == pytest.approx(0.1587, abs=0.01)
    assert np.mean(ratio > critical_value(2.0, 6)) == pytest.approx(0.0228, abs=0.004)
    assert critical_value(1.0, 3) > critical_value(1.0, 6) > critical_value(1.0, 1000) == pytest.approx(1.0, abs=1e-3)
    assert critical_value(1.0, 1) == float("inf")


# -- resuming -------------------------------------------------------------------------------------------------------


def test_each_fit_has_a_checkpoint_of_its_own(tmp_path: Path) -> None:
    """The same selection asks for the same checkpoints again, so that a resumed run finds them."""
    stems = []
    for _ in range(2):
        solver = Scripted(lambda spec: 1e-3)
        fits = FitSequence(solver, Recorder().progress, tmp_path, 5.0)
        select_model(fits, ReflectanceSettings(), 40, Recorder())
        assert all(each is not None and each.seconds == 5.0 for each in solver.checkpoints)
        stems.append([each.stem for each in solver.checkpoints if each is not None])
    assert stems[0] == stems[1] and len(set(stems[0])) == len(stems[0])
    assert CheckpointLocation(tmp_path / "fit_1", 5.0).part("diffuse").stem == tmp_path / "fit_1_diffuse"


class Killed(BaseException):
    """The end of a process."""


def test_a_selection_that_was_killed_repeats_no_finished_fit(tmp_path: Path) -> None:
    """And selects the same model with the same margins."""

    class Storing(Scripted):
        """Reads finished fits, as `ReflectanceSolver.fit` demands; is killed after a number of new ones."""

        def __init__(self, left: int) -> None:
            super().__init__(lambda spec, effort: level(20 + 5 * effort + 2 * (spec.kind == "metal")), noise=0.1)
            self._left = left

        def fit(self, spec: ModelSpec, initial: Any, views: Any, effort: float, *others: Any) -> Fit:
            file = others[1].stem
            if not file.exists():
                if not self._left:
                    raise Killed
                self._left -= 1
                file.write_text("finished")
                return super().fit(spec, initial, views, effort, *others)
            return Fit(spec, effort + (initial.effort if initial else 0.0), tuple(views))

    def run(folder: Path, left: int) -> tuple[Storing, Selection[Fit]]:
        folder.mkdir(exist_ok=True)
        solver = Storing(left)
        return solver, select_model(
            FitSequence(solver, Recorder().progress, folder, 5.0), ReflectanceSettings(), 40, Recorder()
        )

    whole, expected = run(tmp_path / "whole", 1000)
    with pytest.raises(Killed):
        run(tmp_path / "killed", 13)
    rest, selection = run(tmp_path / "killed", 1000)
    assert len(rest.fitted) == len(whole.fitted) - 13
    assert selection.spec == expected.spec and selection.margins == expected.margins
    assert selection.comparisons == expected.comparisons


def test_hypotheses_differ_in_more_than_their_name() -> None:
    specs = hypotheses(ReflectanceSettings())
    assert len(set(specs)) == len(specs) == 8
    assert all(spec.bounces == (INTERREFLECTIONS if spec.light_frame == "world" else 0) for spec in specs)
    assert replace(specs[0], bounces=0) == ModelSpec()
