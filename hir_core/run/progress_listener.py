"""Collects the progress of a stage and sends it to observers in blocks, at most four times a second."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hir_core.errors import InputError
from hir_core.files.array_files import read_arrays, write_arrays
from hir_core.plugins.progress import Progress, Throttle
from hir_core.run.interrupt import raise_lost_interrupt

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

HEARTBEAT_INTERVAL_S = 0.5
"""A stage without progress for this long is reported again, with its seconds, so that users see it is alive."""


class ProgressListener:
    """Receives the progress of one stage; stores the curves of its scalars."""

    def __init__(self, stage: str, plugins: PluginManager, on_progress: Callable[[Progress], None] | None) -> None:
        self._stage = stage
        self._plugins = plugins
        self._on_progress = on_progress
        self._curves: dict[str, list[np.ndarray]] = {}
        self._steps: dict[str, list[np.ndarray]] = {}
        self._pending: dict[str, list[np.ndarray]] = {}
        self._last: Progress | None = None
        self._throttle = Throttle(first_at_once=True)
        self._heartbeat = Throttle(HEARTBEAT_INTERVAL_S, first_at_once=True)
        self._started = self._phase_started = time.perf_counter()
        self.seconds: list[tuple[int, float]] = []
        """Pairs of step and seconds since the stage began, one for each block."""
        self.milestones: list[tuple[str, float]] = []
        """Milestones and their times, in seconds since the stage began."""

    def report(self, progress: Progress) -> None:
        """Receives one block of a stage; raises an interrupt that a library swallowed since the last one."""
        raise_lost_interrupt()
        for name, values in progress.scalars.items():
            block = np.atleast_1d(np.asarray(values, dtype=np.float64))
            self._pending.setdefault(name, []).append(block)
            self._curves.setdefault(name, []).append(block)
            self._steps.setdefault(name, []).append(np.arange(progress.step - len(block) + 1, progress.step + 1))
        # a stage may count steps and seconds level by level: the time left follows from the current level, without
        # what the stage did before its first step
        now = time.perf_counter()
        last = self._last
        if last is None or progress.steps != last.steps or progress.step < last.step:
            self._phase_started = now - progress.seconds
        spent, phase = now - self._started, now - self._phase_started
        if progress.milestone:
            self.milestones.append((progress.milestone, round(spent, 3)))
        self._last = replace(progress, stage=self._stage, seconds=spent, phase_seconds=phase, milestone="")
        if self._throttle.ready or progress.step >= progress.steps:
            self._send()

    @contextlib.contextmanager
    def heartbeat(self) -> Iterator[None]:
        """While the block runs, a thread repeats the last progress when the stage reports none."""
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

    def _beat(self, ended: threading.Event, send: Callable[[Progress], None]) -> None:
        while not ended.wait(HEARTBEAT_INTERVAL_S):
            if self._heartbeat.ready:
                last = self._last or Progress(self._stage, 0, 1, 0.0)
                now = time.perf_counter()
                spent, phase = now - self._started, now - self._phase_started
                send(replace(last, seconds=spent, phase_seconds=phase, scalars={}))

    def close(self, seconds: float) -> None:
        """Sends what is pending, and the end of the stage."""
        last = self._last or Progress(self._stage, 1, 1, seconds)
        self._last = replace(last, step=last.steps, seconds=seconds)
        self._send()

    def write(self, path: Path) -> None:
        """Writes the curves: for each scalar its values and the steps they belong to; nothing where there are none."""
        if not self._curves:
            return
        arrays = {name: np.concatenate(blocks) for name, blocks in self._curves.items()}
        arrays |= {f"{name}@step": np.concatenate(blocks) for name, blocks in self._steps.items()}
        write_arrays(path, arrays)

    def _send(self) -> None:
        if self._last is None:
            return
        self._throttle.restart()
        self._heartbeat.restart()
        block = replace(self._last, scalars={name: np.concatenate(b) for name, b in self._pending.items()})
        self._pending = {}
        self.seconds.append((block.step, round(block.seconds, 3)))
        if self._on_progress is not None:
            self._on_progress(block)
        self._plugins.notify("hir_progress", progress=block)


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
