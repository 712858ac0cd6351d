"""Hypotheses: which one is selected, and what is reported of the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hir_core.config import ReflectanceSettings
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.held_out_views import model_selection_folds
from hir_core.stages.reflectance.reflectance_report import (
    explanation_report,
    hypothesis_reports,
    near_tie_warning,
)
from hir_core.stages.reflectance.selection.fit_sequence import MAX_FITS_AT_ONCE, FitSequence, fits_at_once
from hir_core.stages.reflectance.selection.held_out_comparison import (
    expected_gain,
    is_better_hypothesis,
    is_expected_to_be_better,
)
from hir_core.stages.reflectance.selection.hypotheses import contains, hypotheses, hypothesis
from hir_core.stages.reflectance.selection.model_selection import select_model
from hir_core.stages.reflectance.selection.refinement_selection import COMPARISON
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS
from tests.hir_core.stages.reflectance.selection.scripted_solver import TOTAL, Recorder, Scripted, level, select


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
    for each in selection.contestants:
        *earlier, last = each.rounds
        assert not any(fit.fits for fit in earlier), "no later fit continues them"
        assert bool(last.fits) != each.dropped
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


@pytest.mark.parametrize(("imitated", "expected"), [(0.0, "camera"), (1.0, "world")])
def test_lights_are_compared_without_what_a_light_on_the_camera_imitates(imitated: float, expected: str) -> None:
    """The light on the camera is ahead by 1 dB, of which some is no property of the light; materials are compared by
    the errors of the photographs.
    """

    class Imitating(Scripted):
        def errors_between_lights(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            gain = imitated if fit.spec.light_frame == "camera" else -0.1
            return self.errors(fit, views) * level(-gain)

    def error(spec: ModelSpec) -> float:
        return level(
            30
            + (spec.light_frame == "camera")
            + 0.5 * (spec.kind == "dielectric")
            - 3 * (spec.kind in ("metal", "mixed"))
        )

    selection = select(Imitating(error, noise=0.02), ReflectanceSettings())
    assert selection.hypothesis == hypothesis("dielectric", expected)  # type: ignore[arg-type]
    other = next(m for m in selection.margins if m.spec.light_frame != expected and m.spec.kind == "dielectric")
    assert other.margin_db == pytest.approx(0.9 if expected == "camera" else 0.1, abs=0.05)


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


@pytest.mark.parametrize(("shift", "expected"), [(0.0, "mixed"), (-1.7, "diffuse")])
def test_a_large_mean_gain_decides_though_it_may_be_noise(shift: float, expected: str) -> None:
    """Gains of a spring of painted metal under a lamp, 2.3 ± 2.1 dB: unseen views gain 7 dB. With 0.6 ± 2.1 dB the
    simpler one stays.
    """
    gains = np.array([8.8, -1.1, -5.5, 1.7, 6.4, 3.3]) + shift

    class UnevenGains(Scripted):
        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            ahead = np.resize(gains, len(views)) * (fit.spec.kind == "mixed")
            return np.asarray(super().errors(fit, views) * 10 ** (-ahead / 10))

    selection = select(UnevenGains(lambda spec: level(23)), ReflectanceSettings(light_frame="world"))
    assert selection.hypothesis.kind == expected and selection.is_near_tie


@pytest.mark.parametrize(
    ("held_out", "training", "expected"),
    [(0.3, 3.0, "mixed"), (0.3, 1.5, "diffuse"), (-0.2, 6.0, "diffuse")],
    ids=["training views gain much", "they gain less", "held-out views lose"],
)
def test_training_views_decide_where_held_out_views_do_not(held_out: float, training: float, expected: str) -> None:
    """Gains of held-out views differ much, so their mean is within noise: few of them show the reflection of a sun."""
    uneven = np.array([4.0, -3.5, 2.5, -3.0, 3.5, -3.5])

    class FewJudges(Scripted):
        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            judging = len(views) <= len(uneven)
            ahead = np.resize(uneven, len(views)) + held_out if judging else np.full(len(views), training)
            return np.asarray(super().errors(fit, views) * 10 ** (-ahead * (fit.spec.kind == "mixed") / 10))

    solver = FewJudges(lambda spec: level(25 - 9 * (spec.kind in ("dielectric", "metal"))))
    assert select(solver, ReflectanceSettings(light_frame="world")).hypothesis.kind == expected


def test_an_expected_gain_is_smaller_the_noisier_it_is() -> None:
    assert expected_gain(2.0, 0.0) == 2.0 and expected_gain(2.0, 3.0) == pytest.approx(1.0)
    assert expected_gain(2.0, float("inf")) == 0.0 and expected_gain(-2.0, 3.0) == pytest.approx(-1.0)
    assert is_better_hypothesis(1.2, 1.0, 6) and not is_better_hypothesis(1.0, 1.0, 6)
    assert is_better_hypothesis(0.3, 0.1, 6) and not is_better_hypothesis(0.3, 0.2, 6), (
        "small ones by their noise alone"
    )
    assert not is_better_hypothesis(9.0, float("inf"), 1)


def test_training_views_count_little_and_not_without_held_out_ones() -> None:
    """A vase of painted metal beside a diffuse one, and gold beside gold with plastic, which has more freedom."""
    assert is_expected_to_be_better(held_out=(0.10, 3.07), training=(8.74, 0.80))
    assert not is_expected_to_be_better(held_out=(0.13, 0.14), training=(0.66, 0.09))
    assert not is_expected_to_be_better(held_out=(9.0, float("inf")), training=(9.0, 0.1)), "one held-out view"


@pytest.mark.parametrize("relief", [False, True], ids=["", "normals that only the runner-up shows"])
def test_a_runner_up_gets_the_refinements_of_the_selected_one_and_its_own(relief: bool) -> None:
    """Mixed without maps is ahead of a dielectric, whose specular map explains as much."""

    def error(spec: ModelSpec) -> float:
        gain = {"diffuse": 0.0, "dielectric": 4.0, "metal": 1.0, "mixed": 4.8}[spec.kind]
        shows_relief = relief and spec.kind == "dielectric" and spec.normals == "map"
        return level(25 + gain + 0.8 * (spec.specular == "map") + 2.0 * shows_relief)

    selection = select(Scripted(error, noise=0.01), ReflectanceSettings(light_frame="world"))
    assert selection.spec == ModelSpec("dielectric", "map", normals="map" if relief else "mesh")
    assert selection.hypothesis.kind == "dielectric"
    kinds = [each.spec.kind for each in selection.comparisons]
    assert kinds[0] == "mixed" and kinds[-1] == "dielectric", "its own refinements come after it was selected"


@pytest.mark.parametrize(("gain_of_roughness", "expected"), [(1.5, "metal"), (0.2, "mixed")])
def test_a_metal_gets_a_map_against_a_map_of_metalness(gain_of_roughness: float, expected: str) -> None:
    """A map of metalness, and none of roughness, is ahead of a metal of one roughness."""

    def error(spec: ModelSpec) -> float:
        gain = {"diffuse": 0.0, "dielectric": 1.0, "metal": 4.0, "mixed": 4.8}[spec.kind]
        varies = spec.kind == "metal" and spec.roughness == "map"
        return level(25 + gain + gain_of_roughness * varies)

    selection = select(Scripted(error, noise=0.01), ReflectanceSettings(light_frame="world"))
    assert selection.spec.kind == selection.hypothesis.kind == expected
    assert (selection.spec.roughness == "map") == (expected == "metal")
    assert ModelSpec("metallic", "uniform", "map", metalness="metal") in [each.spec for each in selection.comparisons]


@pytest.mark.parametrize(("ratio", "expected"), [(0.4, "camera"), (1.065, "world")], ids=["5.6 errors", "2.1 errors"])
def test_a_light_on_the_camera_is_not_selected_in_a_near_tie(ratio: float, expected: str) -> None:
    """Both lights are alike until a map was accepted; then one on the camera gains 0.5 dB, which differs by view."""

    class GainOfMaps(Scripted):
        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            sign = np.array([(-1) ** number for number in range(len(views))])
            ahead = fit.spec.light_frame == "camera" and fit.spec.specular == "map"
            return np.asarray(super().errors(fit, views) * 10 ** (-0.05 * ahead * (1 + ratio * sign)))

    solver = GainOfMaps(lambda spec: level(25 + (spec.specular == "map")))
    selection = select(solver, ReflectanceSettings(brdf="dielectric"))
    assert selection.hypothesis.light_frame == expected


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


# -- several fits at the same time ----------------------------------------------------------------------------------


def test_fits_at_the_same_time_select_the_same(tmp_path: Path) -> None:
    """The same selection, in the same order of its record, with checkpoints of the same names."""
    settings = ReflectanceSettings()

    class Waiting(Scripted):
        def fit(self, spec: ModelSpec, *others: Any) -> Any:
            time.sleep(0.001 * (len(spec.name) % 7))  # ends in another order than it begins
            return super().fit(spec, *others)

    def error(spec: ModelSpec, effort: float) -> float:
        return 1e-3 * (1 + 0.01 * len(spec.name)) / (1 + effort)

    found = []
    for at_once in (1, 3):
        solver, recorder = Waiting(error), Recorder()
        fits = FitSequence(solver, recorder.progress, tmp_path, 5.0, at_once)
        selection = select_model(fits, settings, 48, recorder)
        assert recorder.shares == sorted(recorder.shares) and recorder.shares[-1] <= 1
        stems = sorted(each.stem.name for each in solver.checkpoints if each is not None)
        assert len(stems) == len(set(stems)) == len(solver.fitted), "no two fits share a checkpoint"
        found.append((selection.spec, selection.margins, selection.comparisons, stems))
    assert found[0] == found[1]


def test_how_many_fits_run_at_the_same_time() -> None:
    class Concurrent(Scripted):
        concurrent_fits = True

    solver = Concurrent(lambda spec: 1e-3)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        assert fits_at_once(solver, [], "cpu") == 2
        assert fits_at_once(solver, [], "cuda") == 1, "one fit uses a GPU better"
        assert fits_at_once(Scripted(lambda spec: 1e-3), [], "cpu") == 1, "a solver may not allow it"
        torch.set_num_threads(64)
        assert fits_at_once(solver, [], "cpu") == MAX_FITS_AT_ONCE
        largest = max(budget.pixel_share for budget in (*ROUNDS, COMPARISON))
        assert MAX_FITS_AT_ONCE * largest <= 1, "together they have no more pixels than the last fit"
    finally:
        torch.set_num_threads(threads)
