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
from hir_core.plugins.model_spec import Rung
from hir_core.plugins.progress import FIT, VOTE
from hir_core.report.convergence import milestones
from hir_core.run.progress_listener import Listener
from hir_core.run.stage_context import StageContext
from hir_core.stages.reflectance.model_selection import HOLD_OUT_EVERY, Step, climb, compare, forced_rung, split_views
from hir_core.stages.reflectance.reflectance_fit import _Bar


class Scripted(ReflectanceSolver):
    """A solver whose held-out error for each rung is given by a function."""

    def __init__(self, error: Callable[[Rung], float], noise: float = 0.0, learning: float = 1.0) -> None:
        self._error = error
        self._noise = noise
        self._learning = learning
        self.fitted: list[tuple[Rung, tuple[int, ...]]] = []

    def fit(self, rung: Rung, start: Any, views: Sequence[int], effort: float, report: Callable[[float], None]) -> Any:
        self.fitted.append((rung, tuple(views)))
        for share in (0.01, 0.5, 1.0):
            report(share)
        return rung, effort + (start[1] if start else 0.0)

    def errors(self, fit: tuple[Rung, float], views: Sequence[int]) -> np.ndarray:
        rung, effort = fit
        spread = np.random.default_rng(len(rung.name)).normal(0, self._noise, len(views))
        return self._error(rung) * self._learning**effort * np.exp(spread)

    def scene(self, fit: Any, views: Sequence[int], report: Callable[[float], None]) -> Any:
        raise AssertionError("the ladder asks for no textures")

    def radiance(self, material: Any, environment: Any, pixels: Any) -> Any:
        raise AssertionError("the ladder asks for no radiance")


class Overheard:
    """Shares and votes as they were told."""

    def __init__(self) -> None:
        self.shares: list[float] = []
        self.voted_on: list[Rung] = []

    def fitting(self, name: str, share: float) -> None:
        self.shares.append(share)

    def judged(self, held_out_db: float, training_db: float) -> None:
        assert held_out_db <= 120 and training_db <= 120

    def voted(self, step: Step) -> None:
        self.voted_on.append(step.rung)


def chosen(error: Callable[[Rung], float], noise: float = 0.0, views: int = 40, **settings: Any) -> Rung:
    solver = Scripted(error, noise)
    return climb(solver, ReflectanceSettings(**settings), views, Overheard())[1]


def test_a_matt_scene_stays_diffuse() -> None:
    assert chosen(lambda rung: 1e-3) == Rung()


def test_more_steps_alone_are_no_gain() -> None:
    """A fit that improves with every step, whatever the rung, climbs nothing."""
    solver = Scripted(lambda rung: 1e-3, learning=0.3)
    assert climb(solver, ReflectanceSettings(), 40, Overheard())[1] == Rung()
    solver = Scripted(lambda rung: 1e-3 if rung.brdf == "dielectric" else 1e-2, learning=0.3)
    assert climb(solver, ReflectanceSettings(), 40, Overheard())[1] == Rung("dielectric", "uniform")


def test_one_control_serves_all_votes_until_a_candidate_is_kept() -> None:
    solver = Scripted(lambda rung: 1e-3 if rung.brdf == "dielectric" else 1e-2)
    rung = climb(solver, ReflectanceSettings(), 40, Overheard())[1]
    again = [each for each, _ in solver.fitted].count(rung)
    assert again == 2, "once as a candidate, once as the control of a reflection, three maps and normals"


@pytest.mark.parametrize("settings", [{}, {"model": "normal_map"}, {"brdf": "paper", "light_frame": "world"}], ids=str)
@pytest.mark.parametrize("better", ["nothing", "lobes and reflections", "everything but the camera's light"])
def test_a_climb_tells_how_far_it_is(better: str, settings: dict[str, Any]) -> None:
    def error(rung: Rung) -> float:
        if rung.light_frame == "camera" or better == "nothing":
            return 1e-2
        more = (rung.brdf != "diffuse") + rung.bounces
        if better != "lobes and reflections":
            more += rung.colored + (rung.specular, rung.roughness, rung.normals).count("map")
        return 1e-2 * 0.3**more

    overheard = Overheard()
    _, rung, steps = climb(Scripted(error), ReflectanceSettings(**settings), 40, overheard)
    assert overheard.shares == sorted(overheard.shares) and overheard.shares[0] > 0 and overheard.shares[-1] <= 1
    assert overheard.voted_on == [step.rung for step in steps]
    if "model" in settings or better == "lobes and reflections":
        assert overheard.shares[-1] == pytest.approx(1), "that is the course a bar expects"
    elif better != "nothing":
        assert rung.mapped and rung.colored and rung.bounces and rung.normals == "map", "a longer one than expected"


def test_gain_within_its_noise_is_not_kept() -> None:
    def error(rung: Rung) -> float:
        return 1e-3 if rung.brdf == "diffuse" else 0.97e-3

    assert chosen(error).brdf != "diffuse", "the same gain without noise is kept"
    assert chosen(error, noise=1.0).brdf == "diffuse"


@pytest.mark.parametrize(
    "truth",
    [
        Rung("paper", "uniform"),
        Rung("dielectric", "uniform"),
        Rung("dielectric", "map"),
        Rung("dielectric", "uniform", "map"),
        Rung("dielectric", "uniform", colored=True),
        Rung("dielectric", "map", "map", bounces=1),
        Rung("paper", "uniform", light_frame="camera"),
        Rung(bounces=1),
        Rung("dielectric", "uniform", normals="map"),
        Rung(bounces=1, normals="map"),
        Rung("dielectric", "uniform", texels="lobes"),
        Rung("paper", "uniform", colored=True, bounces=1, texels="lobes"),
    ],
    ids=lambda rung: rung.name,
)
def test_every_answer_is_found_where_it_is_right(truth: Rung) -> None:
    def error(rung: Rung) -> float:
        wrong = (
            rung.brdf == truth.brdf,
            rung.specular == truth.specular,
            rung.roughness == truth.roughness,
            rung.colored == truth.colored,
            rung.bounces == truth.bounces,
            rung.light_frame == truth.light_frame,
            rung.normals == truth.normals,
            (rung.texels == "lobes") == (truth.texels == "lobes"),
        )
        return 1e-3 * 2.0 ** wrong.count(False)

    assert chosen(error) == truth


def test_a_lobe_that_indirect_light_explains_is_dropped() -> None:
    """In a matt bowl a lobe takes the place of light between its walls until that is modelled."""

    def error(rung: Rung) -> float:
        return 1e-3 if rung.bounces else 5e-3 if rung.brdf == "diffuse" else 3e-3

    solver = Scripted(error)
    _, rung, steps = climb(solver, ReflectanceSettings(light_frame="world"), 40, Overheard())
    assert rung == Rung(bounces=1)
    kept = [(step.rung.brdf, step.rung.bounces) for step in steps if step.kept]
    assert kept == [("diffuse", 0), ("paper", 0), ("paper", 1), ("diffuse", 1)]

    def glossy(rung: Rung) -> float:
        return (1e-3 if rung.bounces else 3e-3) * (1 if rung.brdf == "dielectric" else 2)

    _, rung, steps = climb(Scripted(glossy), ReflectanceSettings(light_frame="world"), 40, Overheard())
    assert rung == Rung("dielectric", "uniform", bounces=1)
    asked = next(step for step in steps if step.rung == Rung(bounces=1))
    assert not asked.kept and asked.gain_db == pytest.approx(-3.01, abs=0.01)


def test_a_fit_nearer_than_a_step_of_eight_bits_grows_no_further() -> None:
    def twice_as_good(rung: Rung) -> float:
        return 1.0 if rung == Rung() else 0.5

    assert chosen(lambda rung: (1.2 / 255) ** 2 * twice_as_good(rung)) != Rung()
    assert chosen(lambda rung: (0.9 / 255) ** 2 * twice_as_good(rung)) == Rung()


def test_normals_are_not_bent_under_a_light_on_the_camera() -> None:
    def error(rung: Rung) -> float:
        return (1e-3 if rung.normals == "map" else 3e-3) * (1 if rung.light_frame == "camera" else 5)

    assert chosen(error) == Rung(light_frame="camera")
    for model in ("normal_map", "texel_lobes"):
        with pytest.raises(ConfigError, match="stands still"):
            forced_rung(ReflectanceSettings(model=model, light_frame="camera"))


def test_texels_get_no_lobes_where_maps_at_vertices_were_kept() -> None:
    def error(rung: Rung) -> float:
        return 1e-3 * 0.5 ** sum([rung.brdf == "dielectric", rung.normals == "map", rung.texels == "lobes"])

    assert chosen(error) == Rung("dielectric", "uniform", normals="map")


def test_texels_are_compared_with_texels() -> None:
    """Points with albedos of their own fit better than vertices can, whatever the lobe: that is no lobe's gain."""

    def error(rung: Rung) -> float:
        return (1e-3 if rung.texels == "none" else 0.2e-3) * (1 if rung.brdf == "dielectric" else 3)

    solver = Scripted(error)
    _, rung, steps = climb(solver, ReflectanceSettings(), 40, Overheard())
    assert rung == Rung("dielectric", "uniform")
    assert not steps[-1].kept and steps[-1].rung.texels == "lobes" and steps[-1].gain_db == pytest.approx(0)


def test_votes_are_timed_when_they_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits are silent before their first step: that time is theirs, not that of the one before."""
    now = [0.0]
    monkeypatch.setattr("hir_core.run.progress_listener.time.perf_counter", lambda: now[0])

    class Slow(Scripted):
        def fit(self, rung: Rung, *others: Any) -> Any:
            now[0] += 10 + len(self.fitted)
            return super().fit(rung, *others)

    listener = Listener("reflectance", PluginManager(), None)
    bar = _Bar(StageContext(PluginManager(), tmp_path, {}, report=listener.report), 0.0)
    solver = Slow(lambda rung: 1e-3 if rung.brdf == "dielectric" else 1e-2)
    steps = climb(solver, ReflectanceSettings(brdf="dielectric"), 40, bar)[2]
    ended = np.cumsum([10 + number for number in range(len(solver.fitted))])
    timings = {"stages": {"reflectance": {"milestones": listener.milestones}}}
    assert milestones(timings, FIT) == ended[:-2].tolist(), "points in texels are compared, not fitted"
    # the start, a light on the camera, control and lobe, control and reflection, three maps, normals, texels twice
    assert milestones(timings, VOTE) == ended[[0, 1, 3, 5, 6, 7, 8, 9, 11]].tolist()
    assert len(steps) == 9


def test_held_out_views_are_never_fitted() -> None:
    solver = Scripted(lambda rung: 1e-3)
    climb(solver, ReflectanceSettings(), 24, Overheard())
    held_out = set(range(24)[HOLD_OUT_EVERY // 2 :: HOLD_OUT_EVERY])
    assert held_out
    assert all(held_out.isdisjoint(views) for _, views in solver.fitted)


@pytest.mark.parametrize("views", range(6, 30))
def test_few_views_can_climb_too(views: int) -> None:
    """One held-out view alone has no standard error: captures of 6 to 11 photographs stayed diffuse for ever."""
    training, held_out = split_views(views)
    assert len(held_out) >= 3 and len(training) >= len(held_out) and sorted(training + held_out) == list(range(views))
    solver = Scripted(lambda rung: 1e-3 if rung.brdf == "diffuse" else 1e-4)
    _, rung, _ = climb(solver, ReflectanceSettings(light_frame="world"), views, Overheard())
    assert rung.brdf != "diffuse"


def test_too_few_views_fit_the_default_without_a_vote() -> None:
    solver = Scripted(lambda rung: 1e-3)
    _, rung, steps = climb(solver, ReflectanceSettings(), 3, Overheard())
    assert (rung, steps) == (Rung("dielectric", "uniform"), [])
    assert solver.fitted == [(Rung(), (0, 1, 2)), (rung, (0, 1, 2))]


def test_a_named_rung_is_fitted_without_a_vote() -> None:
    assert chosen(lambda rung: 1e-3, model="roughness_map", brdf="paper") == Rung("paper", "map", "map")


@pytest.mark.parametrize("name", [name for name in get_args(ModelName) if name != "auto"])
def test_every_name_of_a_model_is_a_rung(name: ModelName) -> None:
    assert forced_rung(ReflectanceSettings(model=name)) is not None


def test_comparison_is_paired() -> None:
    hard_and_easy = np.array([1e-1, 1e-4, 1e-2])
    gain, noise = compare(hard_and_easy, hard_and_easy / 10)
    assert gain == pytest.approx(10)
    assert noise == pytest.approx(0, abs=1e-9)
