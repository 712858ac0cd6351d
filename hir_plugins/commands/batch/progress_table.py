"""The live table of a batch: a row for each capture in progress, and what the cluster does."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from hir_core.cli.progress_bar import time_text

if TYPE_CHECKING:
    from rich.table import Table

    from hir_plugins.commands.batch.scheduling.driver import Batch
    from hir_plugins.commands.batch.scheduling.events import Event, Running

MOST_ROWS = 30


class BatchTable:
    """A context manager; on anything but a terminal it prints one line for each thing that happened."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet

    def __enter__(self) -> Self:
        from rich.console import Console
        from rich.live import Live

        self._console = Console(stderr=True, quiet=self._quiet, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._shown = self._console.is_terminal and not self._quiet
        if self._shown:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self._live.stop()

    def event(self, event: Event) -> None:
        """Prints what a person wants to read later; progress is for the table."""
        sentence = sentence_of(event)
        if sentence:
            self._console.print(sentence, markup=False)

    def update(self, batch: Batch) -> None:
        """Draws the table anew."""
        if self._shown:
            self._live.update(table_of(batch, time.monotonic()), refresh=True)


def sentence_of(event: Event) -> str:
    """One line for an event, empty where it is not worth one."""
    facts = event.facts
    if event.name == "message":
        return str(facts["message"])
    if event.name == "capture_finished":
        psnr = (facts.get("psnr") or {}).get("object")
        warned = len(facts.get("warnings") or ())
        parts = ["done", "" if psnr is None else f"{psnr:.1f} dB", f"{warned} warnings" if warned else ""]
        return f"{event.capture}: {', '.join(filter(None, parts))}"
    if event.name == "capture_skipped":
        return f"{event.capture}: {facts['reason']}"
    if event.name == "capture_failed":
        return f"{event.capture}: failed: {facts['reason']}"
    if event.name == "group_failed":
        return f"{event.capture}: {facts['group']}: {facts['reason']}; again in {facts['again_in_seconds']:.0f} s"
    return ""


def table_of(batch: Batch, now: float) -> Table:
    """Captures in progress, those that began first on top."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), title=title_of(batch), title_justify="left", title_style="bold")
    for heading in ("capture", "stage", "progress", "seconds", "left", "node"):
        table.add_column(heading, justify="right" if heading in ("seconds", "left") else "left")
    running = sorted(batch.running.values(), key=lambda task: task.began)
    for task in running[:MOST_ROWS]:
        table.add_row(*row_of(batch, task, now))
    if len(running) > MOST_ROWS:
        table.add_row(f"and {len(running) - MOST_ROWS} more")
    return table


def row_of(batch: Batch, task: Running, now: float) -> tuple[str, ...]:
    """Name, stage, progress, seconds of the task, seconds left of the capture, node and process."""
    from hir_plugins.commands.batch.stage_groups import GROUPS

    told = task.told
    seconds = now - task.began
    left = batch.estimate.left(task.chain, seconds)
    again = f" (try {task.chain.failures + 1})" if task.chain.failures else ""
    if told is None:
        return task.chain.name, GROUPS[task.chain.group].name + again, "waits for a place", "", left_text(left), ""
    share = min(told.step / told.steps, 1.0) if told.steps else 0.0
    bar = "━" * round(16 * share) + "·" * (16 - round(16 * share))
    where = f"{told.node} {told.pid}"
    return task.chain.name, told.stage + again, f"{bar} {share:4.0%}", f"{seconds:.0f}", left_text(left), where


def title_of(batch: Batch) -> str:
    """How many are done, how long the rest will take, how busy the cluster is."""
    done, failed = batch.tally["done"], batch.tally["failed"]
    parts = [f"{done} of {len(batch.chains)} done"]
    if failed:
        parts.append(f"{failed} failed")
    begun = [task.chain for task in batch.running.values()]
    left = batch.estimate.batch_left(begun, batch.tally["waiting"], max(len(begun), 1))
    if left is not None:
        parts.append(f"{time_text(left)} left")
    parts += [f"{name} {used:g} of {total:g}" for name, (used, total) in batch.use.items()]
    return " · ".join(parts)


def left_text(seconds: float | None) -> str:
    return "" if seconds is None else time_text(seconds)
