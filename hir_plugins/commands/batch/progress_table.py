"""The live table of a batch in the terminal: one row for each capture in progress."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from hir_core.terminal.progress_bar import time_text

if TYPE_CHECKING:
    from rich.table import Table

    from hir_plugins.commands.batch.scheduling.driver import Batch
    from hir_plugins.commands.batch.scheduling.events import BatchEvent, RunningTask

MAX_ROWS: Final = 30
BAR_WIDTH: Final = 16
"""Characters."""


class BatchTable:
    """A context manager that draws the table; if standard error is no terminal, it prints one line for each event."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet

    def __enter__(self) -> Self:
        from rich.console import Console
        from rich.live import Live

        self._console = Console(stderr=True, quiet=self._quiet, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._is_live = self._console.is_terminal and not self._quiet
        if self._is_live:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def event(self, event: BatchEvent) -> None:
        """Prints the events that a user reads later; progress appears in the table only."""
        sentence = event_sentence(event)
        if sentence:
            self._console.print(sentence, markup=False)

    def update(self, batch: Batch) -> None:
        """Redraws the table."""
        if self._is_live:
            self._live.update(progress_table(batch, time.monotonic()), refresh=True)


def event_sentence(event: BatchEvent) -> str:
    """One line for an event; empty for events that are not printed."""
    details = event.details
    if event.name == "message":
        return str(details["message"])
    if event.name == "capture_finished":
        psnr = (details.get("psnr") or {}).get("object")
        warnings = len(details.get("warnings") or ())
        plural = "" if warnings == 1 else "s"
        parts = ["done", "" if psnr is None else f"{psnr:.1f} dB", f"{warnings} warning{plural}" if warnings else ""]
        return f"{event.capture}: {', '.join(filter(None, parts))}"
    if event.name == "capture_skipped":
        return f"{event.capture}: skipped: {details['reason']}"
    if event.name == "capture_failed":
        return f"{event.capture}: failed: {details['reason']}"
    if event.name == "group_failed":
        retry = f"retrying in {details['retry_in_seconds']:.0f} s"
        return f"{event.capture}: {details['group']}: {details['reason']}; {retry}"
    return ""


def progress_table(batch: Batch, now: float) -> Table:
    """The captures in progress, in the order in which their tasks were submitted; `now` is `time.monotonic()`."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), title=title(batch), title_justify="left", title_style="bold")
    for heading in ("capture", "stage", "progress", "seconds", "left", "node"):
        table.add_column(heading, justify="right" if heading in ("seconds", "left") else "left")
    running = sorted(batch.running.values(), key=lambda task: task.submitted)
    for task in running[:MAX_ROWS]:
        table.add_row(*table_row(batch, task, now))
    if len(running) > MAX_ROWS:
        table.add_row(f"and {len(running) - MAX_ROWS} more")
    return table


def table_row(batch: Batch, task: RunningTask, now: float) -> tuple[str, ...]:
    """Name, stage, progress, seconds of the task, estimated time left of the capture, node and process id."""
    from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

    progress = task.progress
    seconds = now - task.submitted
    left = _time_left_text(batch.estimate.job_seconds_left(task.job, seconds))
    attempt = f" (attempt {task.job.failures + 1})" if task.job.failures else ""
    if progress is None:
        return task.job.name, STAGE_GROUPS[task.job.group].name + attempt, "queued", "", left, ""
    fraction = min(progress.step / progress.steps, 1.0) if progress.steps else 0.0
    filled = round(BAR_WIDTH * fraction)
    bar = "━" * filled + "·" * (BAR_WIDTH - filled)
    node = f"{progress.node} {progress.pid}"
    return task.job.name, progress.stage + attempt, f"{bar} {fraction:4.0%}", f"{seconds:.0f}", left, node


def title(batch: Batch) -> str:
    """The number of finished captures, the estimated time left, and the use of the cluster."""
    done, failed = batch.state_counts["done"], batch.state_counts["failed"]
    parts = [f"{done} of {len(batch.jobs)} done"]
    if failed:
        parts.append(f"{failed} failed")
    started = [task.job for task in batch.running.values()]
    left = batch.estimate.batch_seconds_left(started, batch.state_counts["waiting"], max(len(started), 1))
    if left is not None:
        parts.append(f"{time_text(left)} left")
    parts += [f"{name} {used:g} of {total:g}" for name, (used, total) in batch.usage.items()]
    return " · ".join(parts)


def _time_left_text(seconds: float | None) -> str:
    return "" if seconds is None else time_text(seconds)
