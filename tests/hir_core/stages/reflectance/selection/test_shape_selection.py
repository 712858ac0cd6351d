"""The mesh of the silhouettes or the refined one: decided by held-out views of the selected hypothesis."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.config import ReflectanceSettings
from hir_core.plugins.model_spec import ModelSpec
from hir_core.report.model_selection_table import model_selection
from hir_core.scene import Material, Scene
from hir_core.stages.reflectance.reflectance_report import shape_report, unchanged_mesh_report
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.model_selection import Selection, select_model
from hir_core.stages.reflectance.selection.shape_selection import OtherMeshSelectedError
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS
from hir_core.terminal.run_results import decisions
from tests.fixtures.made_captures import around, ball, fitted, lamps, photographs
from tests.hir_core.stages.reflectance.selection.scripted_solver import Fit, Recorder, Scripted, level


def metal_is_better(base_db: float, noise: float = 0.0, seed: int = 0) -> Scripted:
    """A solver for which metals are 3 dB better than other materials."""

    def error(spec: ModelSpec, effort: float) -> float:
        return level(base_db + 2 * min(effort, 1.0) + 3 * (spec.kind == "metal"))

    return Scripted(error, noise, seed)


def selected(
    refined: Scripted, silhouettes: Scripted, views: int = 48
) -> tuple[Selection[Fit], FitSequence[Fit, None]]:
    recorder = Recorder()
    fits = FitSequence(refined, recorder.progress)
    selection = select_model(fits, ReflectanceSettings(), views, recorder, lambda: silhouettes)
    assert recorder.shares == sorted(recorder.shares) and recorder.shares[-1] <= 1
    return selection, fits


def test_the_silhouettes_are_selected_where_held_out_views_gain() -> None:
    refined, silhouettes = metal_is_better(20, 0.05), metal_is_better(22, 0.05, seed=1)
    selection, fits = selected(refined, silhouettes)
    shape = selection.shape
    assert shape is not None and shape.accepted
    assert shape.gain_db == pytest.approx(2, abs=0.2)
    assert len(shape.curve_db) == len(ROUNDS)
    assert selection.hypothesis.kind == "metal"
    assert fits.solver is silhouettes
    assert {spec.kind for spec, _ in silhouettes.fitted[: len(ROUNDS)]} == {"metal"}
    assert len(silhouettes.fitted) > len(ROUNDS), "refinements continue on the selected shape"
    fitted_there = len(refined.fitted)
    assert all(spec.normals == "mesh" for spec, _ in refined.fitted), f"no refinement among {fitted_there} fits"


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_gain_within_noise_changes_nothing(seed: int) -> None:
    refined, silhouettes = metal_is_better(20, 0.3), metal_is_better(20.05, 0.3, seed)
    selection, fits = selected(refined, silhouettes)
    assert selection.shape is not None and not selection.shape.accepted
    assert fits.solver is refined


def test_a_shape_that_is_behind_gets_no_further_round() -> None:
    refined, silhouettes = metal_is_better(22), metal_is_better(20)
    selection, fits = selected(refined, silhouettes)
    shape = selection.shape
    assert shape is not None and not shape.accepted and shape.gain_db == pytest.approx(-2)
    assert len(shape.curve_db) == 1 and {effort for _, effort, _ in silhouettes.budgets} == {ROUNDS[0].effort}
    assert fits.solver is refined


def with_other_mesh(own: Scripted, other: Scripted, silhouettes: Scripted | None = None) -> Selection[Fit]:
    recorder = Recorder()
    shape = None if silhouettes is None else lambda: silhouettes
    fits = FitSequence(own, recorder.progress)
    selection = select_model(fits, ReflectanceSettings(), 48, recorder, shape, other_mesh=lambda: other)
    assert fits.solver is own and recorder.shares == sorted(recorder.shares) and recorder.shares[-1] <= 1
    return selection


def test_another_mesh_ends_the_selection_where_held_out_views_gain() -> None:
    """Refinements on the wrong mesh would be in vain."""
    own, other = metal_is_better(20, 0.05), metal_is_better(22, 0.05, seed=1)
    with pytest.raises(OtherMeshSelectedError) as raised:
        with_other_mesh(own, other, silhouettes=metal_is_better(30))
    comparison = raised.value.comparison
    assert comparison.accepted and comparison.gain_db == pytest.approx(2, abs=0.2)
    assert {spec.kind for spec, _ in other.fitted} == {"metal"} and len(comparison.curve_db) == len(ROUNDS)
    assert all(spec.normals == "mesh" for spec, _ in own.fitted), "no refinement"
    report = unchanged_mesh_report(comparison, ["hollows"])
    assert report is not None and report.selected
    assert re.fullmatch(r"what hollows changed is left out; with it: \d\.\d ± 0\.\d dB worse", report.sentence)


def test_another_mesh_may_be_behind_at_first_by_what_two_rounds_can_gain() -> None:
    """A fit on the true mesh needs more steps until reflections are sharp."""

    def late(spec: ModelSpec, effort: float) -> float:
        return level(18.6 + 9 * min(effort, 1.0) ** 2 + 3 * (spec.kind == "metal"))

    with pytest.raises(OtherMeshSelectedError):
        with_other_mesh(metal_is_better(20), Scripted(late))
    hopeless = metal_is_better(17.9)
    selection = with_other_mesh(metal_is_better(20), hopeless)
    assert selection.mesh is not None and len(selection.mesh.curve_db) == 1


@pytest.mark.parametrize("other_db", [18.0, 20.05])
def test_another_mesh_is_left_where_held_out_views_do_not_gain_clearly(other_db: float) -> None:
    selection = with_other_mesh(metal_is_better(20, 0.3), metal_is_better(other_db, 0.3, seed=1))
    assert selection.mesh is not None and not selection.mesh.accepted
    document = {"stages": {"reflectance": {"report": {"unchanged_mesh": None, "model": "metal"}}}}
    report = unchanged_mesh_report(selection.mesh, ["hollows"])
    assert report is not None and report.sentence.startswith("what hollows changed is kept; without it: ")
    document["stages"]["reflectance"]["report"]["unchanged_mesh"] = vars(report)
    assert decisions(document) == {"change": report.sentence}
    assert f"In the mesh, {report.sentence} (6 held-out views)." in str(model_selection(document, ()))


def test_without_held_out_views_nothing_is_compared() -> None:
    silhouettes = metal_is_better(30)
    selection, _ = selected(metal_is_better(20), silhouettes, views=4)
    assert selection.shape is None and not silhouettes.fitted
    assert shape_report(selection) is None


@pytest.mark.parametrize(
    ("silhouettes_db", "sentence"),
    [
        (23.0, "silhouettes alone; with photo-consistency: 3.0 ± 0.0 dB worse"),
        (20.05, "silhouettes and photo-consistency; silhouettes alone: 0.1 ± 0.0 dB better, within noise"),
        (18.0, "silhouettes and photo-consistency; silhouettes alone: 2.0 ± 0.0 dB worse"),
    ],
)
def test_terminal_and_report_say_which_shape_was_selected_and_why(silhouettes_db: float, sentence: str) -> None:
    selection, _ = selected(metal_is_better(20), metal_is_better(silhouettes_db))
    report = shape_report(selection)
    assert report is not None
    document = {"stages": {"reflectance": {"report": {"shape": vars(report), "model": "metal"}}}}
    assert decisions(document) == {"shape": sentence}
    assert f"Shape from {sentence} (6 held-out views)." in str(model_selection(document, ()))


@pytest.mark.slow
@pytest.mark.parametrize("silhouettes_are_true", [True, False], ids=["rough refinement", "rough silhouettes"])
def test_the_stage_fits_the_shape_that_explains_the_reflections(silhouettes_are_true: bool, tmp_path: Path) -> None:
    """A golden ball and the same ball with bumps of one hundredth of its radius, which no outline of 32 pixels has."""
    mesh = ball()
    gold = Material.metallic(torch.tensor((0.9, 0.6, 0.25)), torch.ones(1), torch.full((1,), 0.15))
    truth = Scene(mesh, gold, lamps())
    capture = photographs(truth, around(24))
    bumps = 1 + 0.01 * np.random.default_rng(0).normal(size=(len(mesh.positions), 1)).astype(np.float32)
    rough = mesh.positions * torch.from_numpy(bumps)
    refined, silhouettes = (rough, mesh.positions) if silhouettes_are_true else (mesh.positions, rough)
    scene, report = fitted(mesh.with_positions(refined), capture, tmp_path, silhouette_positions=silhouettes)
    assert report.shape is not None
    assert report.shape.silhouettes_selected == silhouettes_are_true, report.shape
    assert torch.equal(scene.mesh.positions, mesh.positions)


@pytest.mark.slow
def test_the_stage_prefers_a_ball_to_one_with_a_false_hollow(tmp_path: Path) -> None:
    """A polished golden ball, and the same ball with a pit at the top that no outline shows."""
    mesh = ball()
    gold = Material.metallic(torch.tensor((0.9, 0.6, 0.25)), torch.ones(1), torch.full((1,), 0.15))
    capture = photographs(Scene(mesh, gold, lamps()), around(24))
    x, y, z = mesh.positions.unbind(1)
    pit = torch.where(y > 0.75, 0.75 - 0.6 * (y - 0.75), y)
    hollow = mesh.with_positions(torch.stack([x, pit, z], dim=1))
    with pytest.raises(OtherMeshSelectedError) as raised:
        fitted(hollow, capture, tmp_path, other_mesh=mesh)
    assert raised.value.comparison.gain_db > 1
