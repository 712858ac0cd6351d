"""Gathers what a stage reports and passes it on in blocks, at most four times a second."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.files.atomic import atomic_path

from hir_core.errors import InputError
from hir_core.files.array_files import read_arrays
from hir_core.plugins.progress import Progress
from hir_core.run.interrupt import raise_lost_interrupt

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

INTERVAL_SECONDS = 0.25
HEARTBEAT_SECONDS = 0.5
"""A stage that says nothing for this long is said to be alive, with its seconds; nobody waits 5 s in silence."""


class ProgressListener:
    """The `report` of one stage; keeps the curves of its scalars."""

    def __init__(self, stage: str, plugins: PluginManager, on_progress: Callable[[Progress], None] | None) -> None:
        self._stage = stage
        self._plugins = plugins
        self._on_progress = on_progress
        self._curves: dict[str, list[np.ndarray]] = {}
        self._steps: dict[str, list[np.ndarray]] = {}
        self._waiting: dict[str, list[np.ndarray]] = {}
        self._last: Progress | None = None
        self._told = 0.0
        self._started = self._phase_started = time.perf_counter()
        self.seconds: list[tuple[int, float]] = []
        """Pairs of step and seconds since the stage began, one for each block."""
        self.milestones: list[tuple[str, float]] = []
        """What ended when, in seconds since the stage began."""

    def report(self, progress: Progress) -> None:
        """Takes one block of a stage; an interrupt that was swallowed since the last one is raised here."""
        raise_lost_interrupt()
        for name, values in progress.scalars.items():
            block = np.atleast_1d(np.asarray(values, dtype=np.float64))
            self._waiting.setdefault(name, []).append(block)
            self._curves.setdefault(name, []).append(block)
            self._steps.setdefault(name, []).append(np.arange(progress.step - len(block) + 1, progress.step + 1))
        # a stage may count its seconds level by level, and begin to count anew: what is left follows from its phase
        if self._last is not None and (progress.steps != self._last.steps or progress.step < self._last.step):
            self._phase_started = time.perf_counter() - progress.seconds
        now = time.perf_counter()
        spent, phase = now - self._started, now - self._phase_started
        if progress.milestone:
            self.milestones.append((progress.milestone, round(spent, 3)))
        self._last = replace(progress, stage=self._stage, seconds=spent, phase_seconds=phase, milestone="")
        now = time.monotonic()
        if now - self._told >= INTERVAL_SECONDS or progress.step >= progress.steps:
            self._tell(now)

    @contextlib.contextmanager
    def heartbeat(self) -> Iterator[None]:
        """While the block runs, a thread repeats the last progress where the stage is silent."""
        if self._on_progress is None:
            yield
            return
        ended = threading.Event()
        thread = threading.Thread(target=self._beat, args=(ended, self._on_progress), name="hir-heartbeat", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _beat(self, ended: threading.Event, tell: Callable[[Progress], None]) -> None:
        while not ended.wait(HEARTBEAT_SECONDS):
            if time.monotonic() - self._told >= HEARTBEAT_SECONDS:
                last = self._last or Progress(self._stage, 0, 1, 0.0)
                now = time.perf_counter()
                spent, phase = now - self._started, now - self._phase_started
                tell(replace(last, seconds=spent, phase_seconds=phase, scalars={}))

    def close(self, seconds: float) -> None:
        """Passes on what still waits, and the end of the stage."""
        last = self._last or Progress(self._stage, 1, 1, seconds)
        self._last = replace(last, step=last.steps, seconds=seconds)
        self._tell(time.monotonic())

    def write(self, path: Path) -> None:
        """Writes the curves: for each scalar its values and the steps they belong to; nothing where there are none."""
        if not self._curves:
            return
        arrays = {name: np.concatenate(blocks) for name, blocks in self._curves.items()}
        arrays |= {f"{name}@step": np.concatenate(blocks) for name, blocks in self._steps.items()}
        with atomic_path(path) as temporary:
            np.savez(temporary, **arrays)  # type: ignore[arg-type]

    def _tell(self, now: float) -> None:
        if self._last is None:
            return
        self._told = now
        told = replace(self._last, scalars={name: np.concatenate(b) for name, b in self._waiting.items()})
        self._waiting = {}
        self.seconds.append((told.step, round(told.seconds, 3)))
        if self._on_progress is not None:
            self._on_progress(told)
        self._plugins.notify("hir_progress", progress=told)


def read_curves(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Steps and values of each scalar of a stage; empty where none were kept, `InputError` where they are damaged."""
    if not path.exists():
        return {}
    curves: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    arrays = read_arrays(path)
    for name, values in arrays.items():
        if name.endswith("@step"):
            continue
        steps = arrays.get(f"{name}@step")
        if (
            steps is None
            or steps.ndim != 1
            or steps.shape != values.shape
            or {steps.dtype.kind, values.dtype.kind} - set("fiu")
        ):
            raise InputError(f"{path} holds a curve {name!r} that is not a number a step; run without --resume")
        curves[name] = steps, values
    return curves
