"""The ladder of models: what is kept, what is not, and by which views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from hir_core.config import ModelName, ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.interfaces import ReflectanceSolver
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.plugins.progress import MODEL_FITTED, MODELS_COMPARED
from hir_core.report.convergence import milestones
from hir_core.run.progress_listener import ProgressListener
from hir_core.run.stage_context import StageContext
from hir_core.stages.reflectance.model_selection import (
    HOLD_OUT_EVERY,
    Step,
    compare,
    forced_spec,
    select_model,
    split_views,
)
from hir_core.stages.reflectance.reflectance_fit import _Bar


class Scripted(ReflectanceSolver):
    """A solver whose held-out error for each rung is given by a function."""

    def __init__(self, error: Callable[[ModelSpec], float], noise: float = 0.0, learning: float = 1.0) -> None:
        self._error = error
        self._noise = noise
        self._learning = learning
        self.fitted: list[tuple[ModelSpec, tuple[int, ...]]] = []

    def fit(
        self, spec: ModelSpec, start: Any, views: Sequence[int], effort: float, report: Callable[[float], None]
    ) -> Any:
        self.fitted.append((spec, tuple(views)))
        for share in (0.01, 0.5, 1.0):
            report(share)
        return spec, effort + (start[1] if start else 0.0)

    def errors(self, fit: tuple[ModelSpec, float], views: Sequence[int]) -> np.ndarray:
        spec, effort = fit
        spread = np.random.default_rng(len(spec.name)).normal(0, self._noise, len(views))
        return self._error(spec) * self._learning**effort * np.exp(spread)

    def scene(self, fit: Any, views: Sequence[int], report: Callable[[float], None]) -> Any:
        raise AssertionError("the ladder asks for no textures")

    def radiance(self, material: Any, environment: Any, pixels: Any) -> Any:
        raise AssertionError("the ladder asks for no radiance")


class Overheard:
    """Shares and votes as they were told."""

    def __init__(self) -> None:
        self.shares: list[float] = []
        self.voted_on: list[ModelSpec] = []

    def fitting(self, name: str, share: float) -> None:
        self.shares.append(share)

    def judged(self, held_out_db: float, training_db: float) -> None:
        assert held_out_db <= 120 and training_db <= 120

    def voted(self, step: Step) -> None:
        self.voted_on.append(step.spec)


def chosen(error: Callable[[ModelSpec], float], noise: float = 0.0, views: int = 40, **settings: Any) -> ModelSpec:
    solver = Scripted(error, noise)
    return select_model(solver, ReflectanceSettings(**settings), views, Overheard())[1]


def test_a_matt_scene_stays_diffuse() -> None:
    assert chosen(lambda spec: 1e-3) == ModelSpec()


def test_more_steps_alone_are_no_gain() -> None:
    """A fit that improves with every step, whatever the rung, climbs nothing."""
    solver = Scripted(lambda spec: 1e-3, learning=0.3)
    assert select_model(solver, ReflectanceSettings(), 40, Overheard())[1] == ModelSpec()
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "dielectric" else 1e-2, learning=0.3)
    assert select_model(solver, ReflectanceSettings(), 40, Overheard())[1] == ModelSpec("dielectric", "uniform")


def test_one_control_serves_all_votes_until_a_candidate_is_kept() -> None:
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "dielectric" else 1e-2)
    spec = select_model(solver, ReflectanceSettings(), 40, Overheard())[1]
    again = [each for each, _ in solver.fitted].count(spec)
    assert again == 2, "once as a candidate, once as the control of a reflection, three maps and normals"


@pytest.mark.parametrize("settings", [{}, {"model": "normal_map"}, {"brdf": "paper", "light_frame": "world"}], ids=str)
@pytest.mark.parametrize("better", ["nothing", "lobes and reflections", "everything but the camera's light"])
def test_a_climb_tells_how_far_it_is(better: str, settings: dict[str, Any]) -> None:
    def error(spec: ModelSpec) -> float:
        if spec.light_frame == "camera" or better == "nothing":
            return 1e-2
        more = (spec.brdf != "diffuse") + spec.bounces
        if better != "lobes and reflections":
            more += spec.colored + (spec.specular, spec.roughness, spec.normals).count("map")
        return 1e-2 * 0.3**more

    overheard = Overheard()
    _, spec, steps = select_model(Scripted(error), ReflectanceSettings(**settings), 40, overheard)
    assert overheard.shares == sorted(overheard.shares) and overheard.shares[0] > 0 and overheard.shares[-1] <= 1
    assert overheard.voted_on == [step.spec for step in steps]
    if "model" in settings or better == "lobes and reflections":
        assert overheard.shares[-1] == pytest.approx(1), "that is the course a bar expects"
    elif better != "nothing":
        assert spec.mapped and spec.colored and spec.bounces and spec.normals == "map", "a longer one than expected"


def test_gain_within_its_noise_is_not_kept() -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 if spec.brdf == "diffuse" else 0.97e-3

    assert chosen(error).brdf != "diffuse", "the same gain without noise is kept"
    assert chosen(error, noise=1.0).brdf == "diffuse"


@pytest.mark.parametrize(
    "truth",
    [
        ModelSpec("paper", "uniform"),
        ModelSpec("dielectric", "uniform"),
        ModelSpec("dielectric", "map"),
        ModelSpec("dielectric", "uniform", "map"),
        ModelSpec("dielectric", "uniform", colored=True),
        ModelSpec("dielectric", "map", "map", bounces=1),
        ModelSpec("paper", "uniform", light_frame="camera"),
        ModelSpec(bounces=1),
        ModelSpec("dielectric", "uniform", normals="map"),
        ModelSpec(bounces=1, normals="map"),
        ModelSpec("dielectric", "uniform", texels="lobes"),
        ModelSpec("paper", "uniform", colored=True, bounces=1, texels="lobes"),
    ],
    ids=lambda spec: spec.name,
)
def test_every_answer_is_found_where_it_is_right(truth: ModelSpec) -> None:
    def error(spec: ModelSpec) -> float:
        wrong = (
            spec.brdf == truth.brdf,
            spec.specular == truth.specular,
            spec.roughness == truth.roughness,
            spec.colored == truth.colored,
            spec.bounces == truth.bounces,
            spec.light_frame == truth.light_frame,
            spec.normals == truth.normals,
            (spec.texels == "lobes") == (truth.texels == "lobes"),
        )
        return 1e-3 * 2.0 ** wrong.count(False)

    assert chosen(error) == truth


def test_a_lobe_that_indirect_light_explains_is_dropped() -> None:
    """In a matt bowl a lobe takes the place of light between its walls until that is modelled."""

    def error(spec: ModelSpec) -> float:
        return 1e-3 if spec.bounces else 5e-3 if spec.brdf == "diffuse" else 3e-3

    solver = Scripted(error)
    _, spec, steps = select_model(solver, ReflectanceSettings(light_frame="world"), 40, Overheard())
    assert spec == ModelSpec(bounces=1)
    kept = [(step.spec.brdf, step.spec.bounces) for step in steps if step.kept]
    assert kept == [("diffuse", 0), ("paper", 0), ("paper", 1), ("diffuse", 1)]

    def glossy(spec: ModelSpec) -> float:
        return (1e-3 if spec.bounces else 3e-3) * (1 if spec.brdf == "dielectric" else 2)

    _, spec, steps = select_model(Scripted(glossy), ReflectanceSettings(light_frame="world"), 40, Overheard())
    assert spec == ModelSpec("dielectric", "uniform", bounces=1)
    asked = next(step for step in steps if step.spec == ModelSpec(bounces=1))
    assert not asked.kept and asked.gain_db == pytest.approx(-3.01, abs=0.01)


def test_a_fit_nearer_than_a_step_of_eight_bits_grows_no_further() -> None:
    def twice_as_good(spec: ModelSpec) -> float:
        return 1.0 if spec == ModelSpec() else 0.5

    assert chosen(lambda spec: (1.2 / 255) ** 2 * twice_as_good(spec)) != ModelSpec()
    assert chosen(lambda spec: (0.9 / 255) ** 2 * twice_as_good(spec)) == ModelSpec()


def test_normals_are_not_bent_under_a_light_on_the_camera() -> None:
    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.normals == "map" else 3e-3) * (1 if spec.light_frame == "camera" else 5)

    assert chosen(error) == ModelSpec(light_frame="camera")
    for model in ("normal_map", "texel_lobes"):
        with pytest.raises(ConfigError, match="stands still"):
            forced_spec(ReflectanceSettings(model=model, light_frame="camera"))


def test_texels_get_no_lobes_where_maps_at_vertices_were_kept() -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 * 0.5 ** sum([spec.brdf == "dielectric", spec.normals == "map", spec.texels == "lobes"])

    assert chosen(error) == ModelSpec("dielectric", "uniform", normals="map")


def test_texels_are_compared_with_texels() -> None:
    """Points with albedos of their own fit better than vertices can, whatever the lobe: that is no lobe's gain."""

    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.texels == "none" else 0.2e-3) * (1 if spec.brdf == "dielectric" else 3)

    solver = Scripted(error)
    _, spec, steps = select_model(solver, ReflectanceSettings(), 40, Overheard())
    assert spec == ModelSpec("dielectric", "uniform")
    assert not steps[-1].kept and steps[-1].spec.texels == "lobes" and steps[-1].gain_db == pytest.approx(0)


def test_votes_are_timed_when_they_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits are silent before their first step: that time is theirs, not that of the one before."""
    now = [0.0]
    monkeypatch.setattr("hir_core.run.progress_listener.time.perf_counter", lambda: now[0])

    class Slow(Scripted):
        def fit(self, spec: ModelSpec, *others: Any) -> Any:
            now[0] += 10 + len(self.fitted)
            return super().fit(spec, *others)

    listener = ProgressListener("reflectance", PluginManager(), None)
    bar = _Bar(StageContext(PluginManager(), tmp_path, {}, report=listener.report), 0.0)
    solver = Slow(lambda spec: 1e-3 if spec.brdf == "dielectric" else 1e-2)
    steps = select_model(solver, ReflectanceSettings(brdf="dielectric"), 40, bar)[2]
    ended = np.cumsum([10 + number for number in range(len(solver.fitted))])
    timings = {"stages": {"reflectance": {"milestones": listener.milestones}}}
    assert milestones(timings, MODEL_FITTED) == ended[:-2].tolist(), "points in texels are compared, not fitted"
    # the start, a light on the camera, control and lobe, control and reflection, three maps, normals, texels twice
    assert milestones(timings, MODELS_COMPARED) == ended[[0, 1, 3, 5, 6, 7, 8, 9, 11]].tolist()
    assert len(steps) == 9


def test_held_out_views_are_never_fitted() -> None:
    solver = Scripted(lambda spec: 1e-3)
    select_model(solver, ReflectanceSettings(), 24, Overheard())
    held_out = set(range(24)[HOLD_OUT_EVERY // 2 :: HOLD_OUT_EVERY])
    assert held_out
    assert all(held_out.isdisjoint(views) for _, views in solver.fitted)


@pytest.mark.parametrize("views", range(6, 30))
def test_few_views_can_climb_too(views: int) -> None:
    """One held-out view alone has no standard error: captures of 6 to 11 photographs stayed diffuse for ever."""
    training, held_out = split_views(views)
    assert len(held_out) >= 3 and len(training) >= len(held_out) and sorted(training + held_out) == list(range(views))
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "diffuse" else 1e-4)
    _, spec, _ = select_model(solver, ReflectanceSettings(light_frame="world"), views, Overheard())
    assert spec.brdf != "diffuse"


def test_too_few_views_fit_the_default_without_a_vote() -> None:
    solver = Scripted(lambda spec: 1e-3)
    _, spec, steps = select_model(solver, ReflectanceSettings(), 3, Overheard())
    assert (spec, steps) == (ModelSpec("dielectric", "uniform"), [])
    assert solver.fitted == [(ModelSpec(), (0, 1, 2)), (spec, (0, 1, 2))]


def test_a_named_rung_is_fitted_without_a_vote() -> None:
    assert chosen(lambda spec: 1e-3, model="roughness_map", brdf="paper") == ModelSpec("paper", "map", "map")


@pytest.mark.parametrize("name", [name for name in get_args(ModelName) if name != "auto"])
def test_every_name_of_a_model_is_a_rung(name: ModelName) -> None:
    assert forced_spec(ReflectanceSettings(model=name)) is not None


def test_comparison_is_paired() -> None:
    hard_and_easy = np.array([1e-1, 1e-4, 1e-2])
    gain, noise = compare(hard_and_easy, hard_and_easy / 10)
    assert gain == pytest.approx(10)
    assert noise == pytest.approx(0, abs=1e-9)
