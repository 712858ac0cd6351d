"""Progress of a run in the terminal: one bar for the current stage, with the remaining time and the current error."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self

from hir_core.files.file_names import on_one_line
from hir_core.plugins.progress import Progress, Throttle

SHOWN_SCALARS = ("psnr", "held_out_psnr", "loss", "iou", "silhouette", "error")
"""Scalars in the order of preference; the first two that a stage reports are printed beside the bar."""


LINE_SECONDS = 4.5
"""Minimum time between two plain lines of a stage."""


class ProgressBar:
    """A context manager. Where stderr is not a terminal it prints plain lines, at most one every `LINE_SECONDS`."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._stage = ""
        self._throttle = Throttle(LINE_SECONDS, first_at_once=True)

    def __enter__(self) -> Self:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        self._console = Console(stderr=True, quiet=self._quiet, highlight=False)
        self._terminal = self._console.is_terminal and not self._quiet
        self._bars = Bars(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]} {task.fields[error]}"),
            console=self._console,
            disable=not self._terminal,
            transient=True,
        )
        self._task = self._bars.add_task("", total=None, left="", error="", visible=False)
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self._bars.stop()

    def message(self, sentence: str) -> None:
        """Prints one line above the bar."""
        self._console.print(on_one_line(sentence), markup=False)

    def update(self, progress: Progress) -> None:
        """Updates the bar; a new stage starts a new bar."""
        error = describe_error(progress)
        left = f"{time_text(progress.seconds_left)} left" if progress.seconds_left else ""
        if not self._terminal:
            self._plain(progress, left, error)
            return
        if progress.stage != self._stage:
            self._stage = progress.stage
            self._bars.remove_task(self._task)
            self._task = self._bars.add_task(progress.stage, total=progress.steps, left="", error="")
        self._bars.update(
            self._task,
            completed=progress.step,
            total=progress.steps,
            left=left,
            error=" ".join(filter(None, (progress.message, error))),
        )

    def _plain(self, progress: Progress, left: str, error: str) -> None:
        if self._quiet:
            return
        if progress.stage == self._stage and not self._throttle.ready:
            return
        self._stage = progress.stage
        self._throttle.restart()
        done = f"{progress.stage}: {progress.step}/{progress.steps} after {time_text(progress.seconds)}"
        parts = [done, progress.message, left, error]
        print(", ".join(part for part in parts if part), file=sys.stderr, flush=True)


def describe_error(progress: Progress) -> str:
    """The latest values of up to two of `SHOWN_SCALARS`."""
    shown = [name for name in SHOWN_SCALARS if name in progress.scalars and len(progress.scalars[name])][:2]
    return " ".join(f"{name.replace('_', ' ')} {progress.scalars[name][-1]:.4g}" for name in shown)


def time_text(seconds: float) -> str:
    """A duration such as `2 min 05 s`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
