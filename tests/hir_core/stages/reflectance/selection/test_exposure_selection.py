"""Equal, recorded or fitted exposures: decided by held-out views, at exposures of their own where any are fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hir_core.capture import Capture
from hir_core.capture.photograph_exposures import Exposures, PhotographExposures
from hir_core.config import ReflectanceSettings
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins.model_spec import ModelSpec
from hir_core.report.model_selection_table import model_selection
from hir_core.scene import Scene
from hir_core.stages.reflectance.reflectance_report import exposure_report
from hir_core.stages.reflectance.selection.exposure_selection import exposures_to_compare
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.model_selection import Selection, select_model
from hir_core.terminal.run_results import decisions
from tests.fixtures.made_captures import BROWN, around, ball, fitted, lamps, make_material, photographs
from tests.hir_core.stages.reflectance.selection.scripted_solver import Fit, Recorder, Scripted, level

CHOICES: tuple[Exposures, ...] = ("equal", "fitted")


class ExposedSolver(Scripted):
    """A solver with scripted errors by the exposures of the fit and those at which held-out views are compared."""

    def __init__(self, levels: Mapping[tuple[str, str], float], noise: float = 0.02) -> None:
        super().__init__(lambda spec: 1.0, noise)
        self._levels = levels

    def fit(self, spec: ModelSpec, initial: Fit | None, views: Sequence[int], effort: float, *rest: Any) -> Fit:  # type: ignore[override]
        fit = super().fit(spec, initial, views, effort, *rest)
        kept = effort == 0 and initial is not None
        fit.exposures = initial.exposures if kept else spec.exposures  # type: ignore[attr-defined, union-attr]
        return fit

    def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
        reached = self._levels[fit.exposures, fit.spec.exposures]  # type: ignore[attr-defined]
        kind = {"diffuse": 0.0, "dielectric": 3.0, "metal": 1.0, "mixed": 3.0}[fit.spec.kind]
        return super().errors(fit, views) * level(reached + kind + min(fit.effort, 2.0))


def selected(
    levels: Mapping[tuple[str, str], float],
    exposures: Sequence[Exposures] = CHOICES,
    differ: bool = False,
    noise: float = 0.02,
    **settings: Any,
) -> tuple[Selection[Fit], ExposedSolver]:
    solver, recorder = ExposedSolver(levels, noise), Recorder()
    fits = FitSequence(solver, recorder.progress)
    found = select_model(fits, ReflectanceSettings(**settings), 48, recorder, None, exposures, exposures_differ=differ)
    assert recorder.shares == sorted(recorder.shares) and recorder.shares[-1] <= 1
    return found, solver


DIFFERENT = {("equal", "equal"): 15.0, ("equal", "fitted"): 20.0, ("fitted", "fitted"): 25.0}
"""dB where exposures differ, by exposures of the fit and of the comparison."""


@pytest.mark.parametrize("settings", [{}, {"model": "specular"}], ids=["auto", "a model by name"])
def test_exposures_are_fitted_where_held_out_views_gain(settings: dict[str, Any]) -> None:
    selection, _ = selected(DIFFERENT, **settings)
    assert selection.exposures.exposures == selection.spec.exposures == "fitted"
    assert selection.exposures.gain_db == pytest.approx(5, abs=0.2)


@pytest.mark.parametrize(
    ("fitted_db", "expected"),
    [(20.15, "fitted"), (19.95, "fitted"), (18.0, "equal")],
    ids=["gain", "noise", "loss"],
)
def test_no_loss_is_enough_where_colours_of_the_same_places_differ(fitted_db: float, expected: str) -> None:
    """With evidence, before the hypotheses and beside the selected material; without it a small gain is noise."""
    levels = {("equal", "equal"): 20.0, ("equal", "fitted"): 20.0, ("fitted", "fitted"): fitted_db}
    (found, with_evidence), (other, without) = (selected(levels, differ=differ, noise=0.2) for differ in (True, False))
    assert found.exposures.exposures == expected and other.exposures.exposures == "equal"

    def of_metal(solver: ExposedSolver) -> set[str]:
        return {spec.exposures for spec, effort, _ in solver.budgets if effort > 0 and spec.kind == "metal"}

    assert expected in of_metal(with_evidence) and of_metal(without) == {"equal"}


def test_nothing_is_fitted_where_held_out_views_are_as_near_at_equal_exposures() -> None:
    selection, solver = selected(dict.fromkeys(DIFFERENT, 25.0))
    assert selection.exposures.exposures == selection.spec.exposures == "equal"
    assert {spec.exposures for (spec, effort, _) in solver.budgets if effort > 0} == {"equal"}


def test_a_fit_with_exposures_is_compared_at_own_exposures_with_one_without() -> None:
    """The simple model is nearer at own exposures because of what it lacks, not because exposures differ."""
    selection, _ = selected({("equal", "equal"): 15.0, ("equal", "fitted"): 20.0, ("fitted", "fitted"): 20.0})
    assert selection.exposures.exposures == "equal"
    assert selection.exposures.gain_db == pytest.approx(0, abs=0.2)


def test_fitted_exposures_are_compared_again_with_the_selected_material() -> None:
    class Imitating(ExposedSolver):
        """Exposures imitate the reflections that a diffuse model lacks."""

        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            self._levels = DIFFERENT if fit.spec.kind == "diffuse" else dict.fromkeys(DIFFERENT, 28.0)
            return super().errors(fit, views)

    solver, recorder = Imitating(DIFFERENT), Recorder()
    found = select_model(
        FitSequence(solver, recorder.progress), ReflectanceSettings(), 48, recorder, None, ("equal", "fitted")
    )
    assert found.exposures.before == "equal" and found.exposures.gain_db == pytest.approx(0, abs=0.2)
    assert any(spec.exposures == "fitted" and spec.kind != "diffuse" for spec, _ in solver.fitted)
    assert found.exposures.exposures == found.spec.exposures == "equal"


@pytest.mark.parametrize(("recorded_db", "expected"), [(25.0, "recorded"), (12.0, "equal")], ids=["right", "wrong"])
def test_recorded_exposures_are_used_where_they_explain_the_photographs(recorded_db: float, expected: str) -> None:
    levels = {
        ("equal", "equal"): 20.0,
        ("recorded", "recorded"): recorded_db,
        ("equal", "fitted"): 20.0,
        ("recorded", "fitted"): recorded_db,
        ("fitted", "fitted"): 25.0,
    }
    selection, _ = selected(levels, ("equal", "recorded", "fitted"))
    assert selection.exposures.exposures == expected


def test_small_differences_show_beside_the_selected_material() -> None:
    class Close(ExposedSolver):
        """A diffuse model is too far from the photographs for their exposures to matter."""

        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            self._levels = dict.fromkeys(DIFFERENT, 15.0) if fit.spec.kind == "diffuse" else DIFFERENT
            return super().errors(fit, views)

    solver, recorder = Close(DIFFERENT), Recorder()
    fits = FitSequence(solver, recorder.progress)
    found = select_model(fits, ReflectanceSettings(), 48, recorder, None, CHOICES)
    assert found.exposures.exposures == found.spec.exposures == "fitted"
    assert found.exposures.gain_db == pytest.approx(5, abs=0.2)


@pytest.mark.parametrize("when", ["before the hypotheses", "beside the material"])
@pytest.mark.parametrize(("stops", "expected"), [(0.03, "equal"), (0.1, "fitted")])
def test_fitted_exposures_that_hardly_differ_are_equal(stops: float, expected: str, when: str) -> None:
    """They gain, but by less than fits are off: what the model lacks."""

    class Telling(ExposedSolver):
        def exposures(self, fit: Fit, views: Sequence[int]) -> np.ndarray | None:
            if fit.exposures == "equal":  # type: ignore[attr-defined]
                return None
            signs = np.where(np.arange(len(views)) % 2, 1.0, -1.0)
            return 2 ** (stops * signs[:, None] * [0.1, 0.2, 1.0])

        def errors(self, fit: Fit, views: Sequence[int]) -> np.ndarray:
            later = when == "beside the material" and fit.spec.kind == "diffuse"
            self._levels = dict.fromkeys(DIFFERENT, 15.0) if later else DIFFERENT
            return super().errors(fit, views)

    solver, recorder = Telling(DIFFERENT), Recorder()
    fits = FitSequence(solver, recorder.progress)
    found = select_model(fits, ReflectanceSettings(), 48, recorder, None, CHOICES)
    assert found.exposures.exposures == found.spec.exposures == expected
    assert found.exposures.gain_db == pytest.approx(5, abs=0.2)
    with_evidence = select_model(fits, ReflectanceSettings(), 48, recorder, None, CHOICES, exposures_differ=True)
    assert with_evidence.spec.exposures == "fitted", "colours of the same places say that exposures differ"


POSITIONS = np.stack([np.cos(ANGLES := np.linspace(0, 2 * np.pi, 48, endpoint=False)), np.sin(ANGLES), 0 * ANGLES], -1)
"""Of 48 cameras around the object."""
SMOOTH = 2 ** (0.3 * np.cos(ANGLES))
IN_STEPS = 2 ** (np.round(3 * 0.6 * np.cos(ANGLES)) / 3)
"""As an automatic camera sets them: thirds of a stop."""


@pytest.mark.parametrize("takes", [[], [0] * 24 + [1] * 24], ids=["one take", "two takes"])
@pytest.mark.parametrize(
    ("factors", "gain_db", "expected"),
    [(SMOOTH, 0.2, "equal"), (SMOOTH, 0.5, "fitted"), (IN_STEPS, 0.2, "fitted")],
    ids=["smooth", "smooth, more gained", "in steps"],
)
def test_exposures_that_change_smoothly_from_camera_to_camera_must_gain_more(
    factors: np.ndarray, gain_db: float, expected: str, takes: Sequence[int]
) -> None:
    """They may imitate the reflections of a metal. An automatic camera changes exposure in steps."""

    class Telling(ExposedSolver):
        def exposures(self, fit: Fit, views: Sequence[int]) -> np.ndarray | None:
            return None if fit.exposures == "equal" else factors[list(views), None] * np.ones(3)  # type: ignore[attr-defined]

    def selected_with(positions: np.ndarray | None) -> str:
        levels = {("equal", "equal"): 15.0, ("equal", "fitted"): 20.0, ("fitted", "fitted"): 20.0 + gain_db}
        recorder = Recorder()
        fits = FitSequence(Telling(levels), recorder.progress)
        found = select_model(
            fits, ReflectanceSettings(), 48, recorder, None, CHOICES, takes=takes, camera_positions=positions
        )
        return found.spec.exposures

    assert selected_with(POSITIONS) == expected
    assert selected_with(None) == "fitted", "without positions nothing tells them from exposures that differ"


def test_exposures_that_the_settings_name_are_not_compared() -> None:
    selection, solver = selected(dict.fromkeys(DIFFERENT, 20.0), ("fitted",))
    assert selection.spec.exposures == selection.exposures.exposures == "fitted"
    assert {spec.exposures for spec, _ in solver.fitted} == {"fitted"}


def test_without_held_out_views_the_simplest_are_used() -> None:
    solver, recorder = ExposedSolver(DIFFERENT), Recorder()
    fits = FitSequence(solver, recorder.progress)
    found = select_model(fits, ReflectanceSettings(), 4, recorder, None, CHOICES)
    assert found.exposures.exposures == found.spec.exposures == "equal"


def capture_with(recorded: float | None) -> Capture:
    capture = photographs(Scene(ball(), make_material(BROWN), lamps()), around(3))
    return replace(capture, views=tuple(replace(view, recorded_exposure=recorded) for view in capture.views))


def test_settings_and_capture_decide_what_is_compared() -> None:
    def found(recorded: float | None, supported: bool = True, **settings: Any) -> Sequence[str]:
        chosen = ReflectanceSettings(**settings)
        return exposures_to_compare(capture_with(recorded), chosen, "example", supported)

    assert found(None) == ("equal", "fitted")
    assert found(0.5) == ("equal", "recorded", "fitted")
    assert found(0.5, supported=False) == ("equal",)
    assert found(0.5, exposures="recorded") == ("recorded",)
    with pytest.raises(CaptureError, match="record no different exposures in their EXIF data; use --set"):
        found(None, exposures="recorded")
    with pytest.raises(
        ConfigError, match=r"the fit of .example. does not support; choose another reflectance\.renderer"
    ):
        found(None, supported=False, exposures="fitted")


def test_terminal_and_report_say_how_exposures_differ() -> None:
    selection, _ = selected(DIFFERENT)
    capture = capture_with(None)
    factors = np.array([[2, 1, 1], [0.5, 1, 1], [1, 1, 1]], np.float32)
    report = exposure_report(selection.exposures, PhotographExposures.of("fitted", capture, factors), capture)
    assert report is not None and report.white_balance_stops == 2 and report.brightness_stops == 0
    sentence = (
        "fitted for each photograph: brightness differs by 0.00 stops, white balance by 2.00; with equal exposures: "
        f"{report.gain_db:.1f} ± {report.standard_error_db:.1f} dB worse"
    )
    document = {"stages": {"reflectance": {"report": {"exposures": vars(report), "model": "metal"}}}}
    assert decisions(document) == {"exposure": sentence}
    assert f"Exposures are {sentence}." in str(model_selection(document, ()))
    assert exposure_report(selection.exposures, PhotographExposures(), capture) is None


FACTORS = np.exp2(np.random.default_rng(5).uniform(-0.6, 0.6, (24, 3)) * [0.3, 1, 0.3])
"""Of red, green and blue; red and blue have a white balance beside green."""
FACTORS[:, [0, 2]] *= FACTORS[:, 1:2]


def exposed(capture: Capture, factors: np.ndarray) -> Capture:
    """The photographs at other exposures, clipped at 1."""

    def read(view: Any, factor: np.ndarray) -> Callable[[], Any]:
        pixels = view.read()
        color = pixels.color_linear * factor.astype(np.float32)
        changed = replace(pixels, color_linear=np.minimum(color, 1), saturated=(color >= 1).any(axis=2))
        return lambda: changed

    views = (replace(v, read=read(v, factor)) for v, factor in zip(capture.views, factors, strict=True))
    return replace(capture, views=tuple(views))


@pytest.mark.slow
@pytest.mark.parametrize("changes", [True, False], ids=["different", "equal"])
def test_the_exposures_of_photographs_of_a_shiny_ball_are_recovered(changes: bool, tmp_path: Path) -> None:
    truth = Scene(ball(), make_material(BROWN, 0.04, 0.2, "dielectric"), lamps())
    factors = FACTORS if changes else np.ones_like(FACTORS)
    capture = exposed(photographs(truth, around(24)), 0.6 * factors)
    _, report = fitted(truth.mesh, capture, tmp_path)
    assert report.explanation is not None and report.explanation.chosen.startswith("dielectric"), report.explanation
    if not changes:
        assert report.exposures is None
        return
    assert report.exposures is not None and report.exposures.selected == "fitted"
    found = np.array([report.exposures.factors[view.name] for view in capture.views])
    expected = FACTORS / np.exp(np.log(FACTORS).mean(axis=0))
    stops = np.log2(found / expected)
    # of 1.2 stops between photographs; what a short fit does not know of the highlights stays in the exposures
    assert np.sqrt(np.square(stops).mean()) < 1 / 16 and np.abs(stops).max() < 1 / 6
