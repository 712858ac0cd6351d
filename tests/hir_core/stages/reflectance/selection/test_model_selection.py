"""Model selection: held-out views, requested models, comparisons of few views, and checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from hir_core.config import ModelName, ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.interfaces import CheckpointLocation
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.held_out_views import held_out_for_model_selection, model_selection_folds
from hir_core.stages.reflectance.reflectance_report import (
    explanation_report,
    near_tie_warning,
)
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.held_out_comparison import critical_value, decibels, paired_gain
from hir_core.stages.reflectance.selection.hypotheses import INTERREFLECTIONS, forcing_settings, hypotheses, hypothesis
from hir_core.stages.reflectance.selection.model_selection import Selection, select_model
from hir_core.stages.reflectance.selection.requested_model import forced_spec
from tests.hir_core.stages.reflectance.selection.scripted_solver import Fit, Recorder, Scripted, chosen, level, select


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
