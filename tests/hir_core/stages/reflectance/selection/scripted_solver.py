"""A solver with scripted errors, for tests of model selection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hir_core.config import ReflectanceSettings
from hir_core.plugins.interfaces import CheckpointLocation, ReflectanceSolver
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.model_selection import Selection, select_model
from hir_core.stages.reflectance.selection.refinement_selection import Comparison
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS

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
        assert set(fit.views).isdisjoint(views) or set(fit.views).issuperset(views), "held out or fitted, not both"
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
