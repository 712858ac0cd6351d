"""The fits of one reflectance stage in their order: each with its checkpoint and its share of the progress."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Generic, final

from hir_core.plugins.interfaces import CheckpointLocation, FitT, RefinementT, ReflectanceSolver
from hir_core.plugins.model_spec import ModelSpec

MIN_COST_SHARE = 0.2
"""Time of a step on very few pixels, as a share of one on all: the light and the mesh are as large."""


def fit_cost(spec: ModelSpec, effort: float, pixel_share: float = 1.0) -> float:
    """Estimated time of a fit in full diffuse fits; for the progress bar alone."""
    pixels = MIN_COST_SHARE + (1 - MIN_COST_SHARE) * pixel_share
    return effort * pixels * (1 if spec.brdf == "diffuse" else 2) * (1.5 if spec.normals == "map" else 1)


@final
class FitSequence(Generic[FitT, RefinementT]):
    """Runs fits one after the other.

    The sequence is a function of settings and capture, so that a resumed stage runs the same fits in the same order and
    finds the checkpoints of those that had finished. Without a folder nothing is stored.
    """

    def __init__(
        self,
        solver: ReflectanceSolver[FitT, RefinementT],
        progress: Callable[[str, float], None],
        folder: Path | None = None,
        seconds: float = 0.0,
    ) -> None:
        """`progress` receives the name of a model and the share of the expected cost that is done; never less."""
        self.solver = solver
        self._progress = progress
        self._folder = folder
        self._seconds = seconds
        self._count = 0
        self._expected = self._started = self._share = 0.0

    def expect(self, cost: float) -> None:
        """The cost of all fits to come; it may be stated again, and a longer sequence is allowed."""
        self._expected = self._started + cost

    def fit(
        self,
        spec: ModelSpec,
        initial: FitT | None,
        views: Sequence[int],
        effort: float,
        pixel_share: float = 1.0,
        cost_effort: float | None = None,
    ) -> FitT:
        """`ReflectanceSolver.fit` with the next checkpoint; its progress counts as a fit of `cost_effort`."""
        report = self._part(spec, fit_cost(spec, effort if cost_effort is None else cost_effort, pixel_share))
        checkpoint = self.checkpoint(spec, views, effort, pixel_share)
        return self.solver.fit(spec, initial, views, effort, report, checkpoint, pixel_share)

    def checkpoint(
        self, spec: ModelSpec, views: Sequence[int], effort: float, pixel_share: float = 1.0
    ) -> CheckpointLocation | None:
        """Where the next fit of the sequence stores its state."""
        if self._folder is None:
            return None
        self._count += 1
        key = repr((spec, tuple(views), effort, pixel_share))
        digest = hashlib.blake2b(key.encode(), digest_size=8).hexdigest()
        return CheckpointLocation(self._folder / f"fit_{self._count}_{digest}", self._seconds)

    def _part(self, spec: ModelSpec, cost: float) -> Callable[[float], None]:
        begin = self._started
        self._started += cost

        def report(share: float) -> None:
            self._share = max(self._share, (begin + cost * share) / max(self._expected, self._started))
            self._progress(spec.name, self._share)

        return report
