"""Model selection: which candidates are accepted, and which views decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from hir_core.stages.held_out_views import HELD_OUT_INTERVAL, held_out_for_model_selection
from hir_core.stages.reflectance.fit_sequence import FitSequence
from hir_core.stages.reflectance.held_out_comparison import paired_gain
from hir_core.stages.reflectance.model_selection import Comparison, select_model
from hir_core.stages.reflectance.requested_model import forced_spec
from hir_core.stages.reflectance.stage_progress import StageProgress

Fit = tuple[ModelSpec, float]
"""A model and the effort that was spent on it."""


class Scripted(ReflectanceSolver[Fit, None]):
    """A solver whose held-out error is a function of the model."""

    def __init__(self, error: Callable[[ModelSpec], float], noise: float = 0.0, learning: float = 1.0) -> None:
        self._error = error
        self._noise = noise
        self._learning = learning
        self.fitted: list[tuple[ModelSpec, tuple[int, ...]]] = []
        self.checkpoints: list[CheckpointLocation | None] = []

    def fit(
        self,
        spec: ModelSpec,
        initial: Fit | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None = None,
    ) -> Fit:
        self.fitted.append((spec, tuple(views)))
        self.checkpoints.append(checkpoint)
        for share in (0.01, 0.5, 1.0):
            report(share)
        return spec, effort + (initial[1] if initial else 0.0)

    def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
        spec, effort = fit
        noise = np.random.default_rng(len(spec.name)).normal(0, self._noise, len(views))
        return self._error(spec) * self._learning**effort * np.exp(noise)

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

    def evaluated(self, held_out_db: float, training_db: float) -> None:
        assert held_out_db <= 120 and training_db <= 120

    def compared(self, comparison: Comparison) -> None:
        self.comparisons.append(comparison)


def select(
    solver: Scripted, settings: ReflectanceSettings, views: int, recorder: Recorder | None = None
) -> tuple[Fit, ModelSpec, list[Comparison]]:
    recorder = recorder or Recorder()
    return select_model(FitSequence(solver, recorder.progress), settings, views, recorder)


def chosen(error: Callable[[ModelSpec], float], noise: float = 0.0, views: int = 40, **settings: Any) -> ModelSpec:
    solver = Scripted(error, noise)
    return select(solver, ReflectanceSettings(**settings), views)[1]


def test_a_matt_scene_stays_diffuse() -> None:
    assert chosen(lambda spec: 1e-3) == ModelSpec()


def test_more_steps_alone_are_no_gain() -> None:
    """Fits that improve with every step alike accept no candidate."""
    solver = Scripted(lambda spec: 1e-3, learning=0.3)
    assert select(solver, ReflectanceSettings(), 40)[1] == ModelSpec()
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "dielectric" else 1e-2, learning=0.3)
    assert select(solver, ReflectanceSettings(), 40)[1] == ModelSpec("dielectric", "uniform")


def test_one_control_serves_all_comparisons_until_a_candidate_is_accepted() -> None:
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "dielectric" else 1e-2)
    spec = select(solver, ReflectanceSettings(), 40)[1]
    again = [each for each, _ in solver.fitted].count(spec)
    assert again == 2, "once as a candidate, once as the control of a reflection, three maps and normals"


@pytest.mark.parametrize("settings", [{}, {"model": "normal_map"}, {"brdf": "paper", "light_frame": "world"}], ids=str)
@pytest.mark.parametrize("better", ["nothing", "lobes and reflections", "everything but the camera's light"])
def test_progress_rises_to_the_end(better: str, settings: dict[str, Any]) -> None:
    def error(spec: ModelSpec) -> float:
        if spec.light_frame == "camera" or better == "nothing":
            return 1e-2
        more = (spec.brdf != "diffuse") + spec.bounces
        if better != "lobes and reflections":
            more += spec.colored + (spec.specular, spec.roughness, spec.normals).count("map")
        return 1e-2 * 0.3**more

    recorder = Recorder()
    _, spec, comparisons = select(Scripted(error), ReflectanceSettings(**settings), 40, recorder)
    assert recorder.shares == sorted(recorder.shares) and recorder.shares[0] > 0 and recorder.shares[-1] <= 1
    assert recorder.comparisons == comparisons
    if "model" in settings or better == "lobes and reflections":
        assert recorder.shares[-1] == pytest.approx(1), "the expected course"
    elif better != "nothing":
        assert spec.mapped and spec.colored and spec.bounces and spec.normals == "map", "a longer course than expected"


def test_a_gain_within_its_standard_error_is_rejected() -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 if spec.brdf == "diffuse" else 0.97e-3

    assert chosen(error).brdf != "diffuse", "the same gain without noise is accepted"
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
        ModelSpec("dielectric", "uniform", per_texel="brdf"),
        ModelSpec("paper", "uniform", colored=True, bounces=1, per_texel="brdf"),
    ],
    ids=lambda spec: spec.name,
)
def test_the_true_model_is_selected(truth: ModelSpec) -> None:
    def error(spec: ModelSpec) -> float:
        wrong = (
            spec.brdf == truth.brdf,
            spec.specular == truth.specular,
            spec.roughness == truth.roughness,
            spec.colored == truth.colored,
            spec.bounces == truth.bounces,
            spec.light_frame == truth.light_frame,
            spec.normals == truth.normals,
            (spec.per_texel == "brdf") == (truth.per_texel == "brdf"),
        )
        return 1e-3 * 2.0 ** wrong.count(False)

    assert chosen(error) == truth


def test_a_lobe_that_imitates_indirect_light_is_removed() -> None:
    """In a matt bowl a lobe imitates the light between its walls until that is modelled."""

    def error(spec: ModelSpec) -> float:
        return 1e-3 if spec.bounces else 5e-3 if spec.brdf == "diffuse" else 3e-3

    solver = Scripted(error)
    _, spec, comparisons = select(solver, ReflectanceSettings(light_frame="world"), 40)
    assert spec == ModelSpec(bounces=1)
    accepted = [(each.spec.brdf, each.spec.bounces) for each in comparisons if each.accepted]
    assert accepted == [("diffuse", 0), ("paper", 0), ("paper", 1), ("diffuse", 1)]

    def glossy(spec: ModelSpec) -> float:
        return (1e-3 if spec.bounces else 3e-3) * (1 if spec.brdf == "dielectric" else 2)

    _, spec, comparisons = select(Scripted(glossy), ReflectanceSettings(light_frame="world"), 40)
    assert spec == ModelSpec("dielectric", "uniform", bounces=1)
    reconsidered = next(each for each in comparisons if each.spec == ModelSpec(bounces=1))
    assert not reconsidered.accepted and reconsidered.gain_db == pytest.approx(-3.01, abs=0.01)


def test_a_fit_within_one_step_of_eight_bits_is_sufficient() -> None:
    def twice_as_good(spec: ModelSpec) -> float:
        return 1.0 if spec == ModelSpec() else 0.5

    assert chosen(lambda spec: (1.2 / 255) ** 2 * twice_as_good(spec)) != ModelSpec()
    assert chosen(lambda spec: (0.9 / 255) ** 2 * twice_as_good(spec)) == ModelSpec()


def test_no_normal_map_under_a_light_on_the_camera() -> None:
    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.normals == "map" else 3e-3) * (1 if spec.light_frame == "camera" else 5)

    assert chosen(error) == ModelSpec(light_frame="camera")
    for model in ("normal_map", "per_texel_brdf"):
        with pytest.raises(ConfigError, match="fixed in the world"):
            forced_spec(ReflectanceSettings(model=model, light_frame="camera"))


def test_no_per_texel_brdf_after_maps_at_vertices() -> None:
    def error(spec: ModelSpec) -> float:
        return 1e-3 * 0.5 ** sum([spec.brdf == "dielectric", spec.normals == "map", spec.per_texel == "brdf"])

    assert chosen(error) == ModelSpec("dielectric", "uniform", normals="map")


def test_per_texel_brdf_is_compared_with_per_texel_albedo() -> None:
    """Points with their own albedo fit better than vertices, whatever the lobe: that is not a gain of the lobe."""

    def error(spec: ModelSpec) -> float:
        return (1e-3 if spec.per_texel == "none" else 0.2e-3) * (1 if spec.brdf == "dielectric" else 3)

    solver = Scripted(error)
    _, spec, comparisons = select(solver, ReflectanceSettings(), 40)
    assert spec == ModelSpec("dielectric", "uniform")
    last = comparisons[-1]
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
    solver = Slow(lambda spec: 1e-3 if spec.brdf == "dielectric" else 1e-2)
    fits = FitSequence(solver, bar.selecting)
    comparisons = select_model(fits, ReflectanceSettings(brdf="dielectric"), 40, bar)[2]
    ended = np.cumsum([10 + number for number in range(len(solver.fitted))])
    timings = {"stages": {"reflectance": {"milestones": listener.milestones}}}
    assert milestones(timings, MODEL_FITTED) == ended[:-2].tolist(), "per-texel models are compared, not fitted"
    # first, light on camera, control and lobe, control and indirect light, three maps, normals, two per-texel models
    assert milestones(timings, MODELS_COMPARED) == ended[[0, 1, 3, 5, 6, 7, 8, 9, 11]].tolist()
    assert len(comparisons) == 9


def test_held_out_views_are_never_fitted() -> None:
    solver = Scripted(lambda spec: 1e-3)
    select(solver, ReflectanceSettings(), 24)
    held_out = set(range(24)[HELD_OUT_INTERVAL // 2 :: HELD_OUT_INTERVAL])
    assert held_out
    assert all(held_out.isdisjoint(views) for _, views in solver.fitted)


@pytest.mark.parametrize("views", range(6, 30))
def test_few_views_are_enough_for_a_selection(views: int) -> None:
    """One held-out view alone has no standard error: captures of 6 to 11 photographs would stay diffuse."""
    training, held_out = held_out_for_model_selection(views)
    assert len(held_out) >= 3 and len(training) >= len(held_out) and sorted(training + held_out) == list(range(views))
    solver = Scripted(lambda spec: 1e-3 if spec.brdf == "diffuse" else 1e-4)
    _, spec, _ = select(solver, ReflectanceSettings(light_frame="world"), views)
    assert spec.brdf != "diffuse"


def test_too_few_views_fit_the_default_model() -> None:
    solver = Scripted(lambda spec: 1e-3)
    _, spec, comparisons = select(solver, ReflectanceSettings(), 3)
    assert (spec, comparisons) == (ModelSpec("dielectric", "uniform"), [])
    assert solver.fitted == [(ModelSpec(), (0, 1, 2)), (spec, (0, 1, 2))]


def test_a_named_model_is_fitted_without_a_comparison() -> None:
    assert chosen(lambda spec: 1e-3, model="roughness_map", brdf="paper") == ModelSpec("paper", "map", "map")


@pytest.mark.parametrize("name", [name for name in get_args(ModelName) if name != "auto"])
def test_every_model_name_has_a_spec(name: ModelName) -> None:
    assert forced_spec(ReflectanceSettings(model=name)) is not None


def test_comparison_is_paired() -> None:
    hard_and_easy = np.array([1e-1, 1e-4, 1e-2])
    gain, noise = paired_gain(hard_and_easy, hard_and_easy / 10)
    assert gain == pytest.approx(10)
    assert noise == pytest.approx(0, abs=1e-9)


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
