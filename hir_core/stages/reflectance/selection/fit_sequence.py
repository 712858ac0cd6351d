"""The fits of one reflectance stage in their order: each with its checkpoint and its share of the progress."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar, final

import torch

from hir_core.optimization.parallel_jobs import StopSignal, run_in_parallel
from hir_core.plugins.interfaces import CheckpointLocation, FitT, RefinementT, ReflectanceSolver, WeightedTerm
from hir_core.plugins.model_spec import ModelSpec
from hir_core.run.machine import return_freed_memory

T = TypeVar("T")

MAX_FITS_AT_ONCE = 3
"""Each has its own lobes in memory. Those of the model selection use at most 0.3 of the pixels, so that three need less
than the last fit, which uses all: the estimate of the stage's memory holds."""
MIN_COST_SHARE = 0.2
"""Time of a step on very few pixels, as a share of one on all: the light and the mesh are as large."""


def fit_cost(spec: ModelSpec, effort: float, pixel_share: float = 1.0) -> float:
    """Estimated time of a fit in full diffuse fits; for the progress bar alone."""
    pixels = MIN_COST_SHARE + (1 - MIN_COST_SHARE) * pixel_share
    return effort * pixels * (1 if spec.brdf == "diffuse" else 2) * (1.5 if spec.normals == "map" else 1)


def fits_at_once(solver: ReflectanceSolver[FitT, RefinementT], terms: Sequence[WeightedTerm], device: str) -> int:
    """How many fits may run at the same time: a thread of torch for each, where the solver allows it.

    One on a GPU, which a single fit uses better, and with regularizers, whose plugins promise nothing about threads.
    """
    if not solver.concurrent_fits or terms or device != "cpu":
        return 1
    return min(torch.get_num_threads(), MAX_FITS_AT_ONCE)


@final
class SequenceProgress:
    """The share of all fits that is done, also where several run at the same time.

    A fit fills the part of the bar that is still empty, by its share of the cost that is still expected. So the bar
    neither jumps where hypotheses are dropped nor stands still where more is to be fitted than was expected.
    """

    def __init__(self, progress: Callable[[str, float], None]) -> None:
        """`progress` receives the name of a model and the share that is done; never less."""
        self._progress = progress
        self._lock = threading.Lock()
        self._expected = self._begun = self._done = self._share = 0.0
        self.signal = StopSignal()

    def expect(self, cost: float) -> None:
        """The cost of all fits to come; it may be stated again, and a longer sequence is allowed."""
        self._expected = self._begun + cost

    def alone(self, call: Callable[[], None]) -> None:
        """Calls a function while no fit reports anything."""
        with self._lock:
            call()

    def part(self, spec: ModelSpec, cost: float) -> Callable[[float], None]:
        """Receives the share of one fit that is done."""
        reported = 0.0
        with self._lock:
            self._begun += cost

        def report(share: float) -> None:
            nonlocal reported
            self.signal.check()
            with self._lock:
                step = cost * max(share - reported, 0.0)
                remaining = max(self._expected, self._begun) - self._done
                if step > 0:
                    self._share += (1 - self._share) * step / max(remaining, step)
                self._done += step
                reported = max(share, reported)
                self._progress(spec.name, min(self._share, 1.0))

        return report


@final
class FitSequence(Generic[FitT, RefinementT]):
    """Runs fits one after the other, or in branches side by side.

    The sequence is a function of settings and capture, so that a resumed stage runs the same fits in the same order and
    finds the checkpoints of those that had finished. Without a folder nothing is stored.
    """

    def __init__(
        self,
        solver: ReflectanceSolver[FitT, RefinementT],
        progress: Callable[[str, float], None],
        folder: Path | None = None,
        seconds: float = 0.0,
        at_once: int = 1,
    ) -> None:
        """`progress` receives the name of a model and the share of the expected cost that is done; never less.
        `at_once`: fits that may run at the same time.
        """
        self.solver = solver
        self._progress = SequenceProgress(progress)
        self._folder = folder
        self._seconds = seconds
        self._at_once = at_once
        self._prefix = ""
        self._count = 0

    def expect(self, cost: float) -> None:
        """The cost of all fits to come; it may be stated again, and a longer sequence is allowed."""
        self._progress.expect(cost)

    def in_branches(
        self, jobs: Sequence[Callable[[FitSequence[FitT, RefinementT]], T]], ended: Callable[[T], None]
    ) -> list[T]:
        """The results of jobs that do not depend on each other, in their order. Each runs its fits in a branch of the
        sequence; as many branches run at the same time as the sequence allows. `ended` receives each result when it is
        there, one after the other.
        """

        def run(job: Callable[[FitSequence[FitT, RefinementT]], T], branch: FitSequence[FitT, RefinementT]) -> T:
            result = job(branch)
            self._progress.alone(lambda: ended(result))
            return result

        calls = [partial(run, job, self._branch()) for job in jobs]
        results = run_in_parallel(calls, self._at_once, self._progress.signal)
        if self._at_once > 1:
            return_freed_memory()  # glibc keeps for each thread what it has freed, also when the thread has ended
        return results

    def _branch(self) -> FitSequence[FitT, RefinementT]:
        branch = copy(self)
        self._count += 1
        branch._prefix, branch._count, branch._at_once = f"{self._prefix}{self._count}_", 0, 1
        return branch

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
        cost = fit_cost(spec, effort if cost_effort is None else cost_effort, pixel_share)
        report = self._progress.part(spec, cost)
        checkpoint = self.checkpoint(spec, views, effort, pixel_share)
        fit = self.solver.fit(spec, initial, views, effort, report, checkpoint, pixel_share)
        report(1.0)
        return fit

    def checkpoint(
        self, spec: ModelSpec, views: Sequence[int], effort: float, pixel_share: float = 1.0
    ) -> CheckpointLocation | None:
        """Where the next fit of the sequence stores its state."""
        if self._folder is None:
            return None
        self._count += 1
        key = repr((spec, tuple(views), effort, pixel_share))
        digest = hashlib.blake2b(key.encode(), digest_size=8).hexdigest()
        return CheckpointLocation(self._folder / f"fit_{self._prefix}{self._count}_{digest}", self._seconds)
