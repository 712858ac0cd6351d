"""`hir batch`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, TextIO

import click

from hir_core.files.file_names import on_one_line
from hir_core.terminal.command_options import FOLDER, plugin_option, settings_options, verbosity_options

if TYPE_CHECKING:
    from hir_plugins.commands.batch.scheduling.events import BatchEvent

EXIT_SOME_FAILED: Final = 3
EXIT_INTERRUPTED: Final = 130


@click.command("batch")
@click.argument("captures", nargs=-1, metavar="CAPTURES...")
@click.option("-o", "--output", "destination", required=True, metavar="DEST", help="Folder or URL for the results.")
@click.option(
    "--from", "lists", multiple=True, metavar="FILE", help="File or URL that lists captures, one per line. Repeatable."
)
@click.option(
    "--address",
    default="auto",
    show_default=True,
    help="Ray cluster: local starts one here, ray://HOST:PORT or HOST:PORT connects to one, auto connects if it finds "
    "one and starts one otherwise.",
)
@settings_options
@click.option("--cpus", type=click.FloatRange(min=0), default=1.0, show_default=True, help="CPU cores of each task.")
@click.option(
    "--gpus",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    help="GPUs, or a fraction of one, of each geometry and reflectance task.",
)
@click.option(
    "--request",
    "requests",
    multiple=True,
    metavar="KEY=VALUE",
    help="Resources of one group of stages, such as reflectance.memory_gib=6 or export.cpus=2. Repeatable.",
)
@click.option(
    "--attempts",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="How often a task is started if workers, nodes or the store fail.",
)
@click.option(
    "--max-in-progress",
    type=click.IntRange(min=0),
    default=0,
    help="Captures to process at the same time; by default as many as the cluster has resources for.",
)
@click.option("--retry-failed", is_flag=True, help="Process captures again that failed in an earlier call.")
@click.option("--drop-stages", is_flag=True, help="Omit stages/ from the results; only --resume needs it.")
@click.option(
    "--cache", type=FOLDER, metavar="DIR", help="Folder for local files on each node; by default a temporary one."
)
@click.option("--deterministic", is_flag=True, help="The same input gives the same bytes on the same machine; slower.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per event instead of a table.")
@plugin_option
@verbosity_options
def batch_command(
    captures: tuple[str, ...],
    destination: str,
    lists: tuple[str, ...],
    address: str,
    preset: str,
    config_file: Path | None,
    assignments: tuple[str, ...],
    cpus: float,
    gpus: float,
    requests: tuple[str, ...],
    attempts: int,
    max_in_progress: int,
    retry_failed: bool,
    drop_stages: bool,
    cache: Path | None,
    deterministic: bool,
    as_json: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Reconstructs many CAPTURES on a Ray cluster.

    DEST receives one run directory per capture, and the summary as batch.json and batch.html. CAPTURES and DEST are
    folders or URLs (s3://…, gs://…); CAPTURES may contain wildcards. Repeating the call continues an interrupted batch
    and skips finished captures. Exit code 3 means that some captures failed.
    """
    from hir_core.config import load_config
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.batch.batch_options import BatchOptions
    from hir_plugins.commands.batch.progress_table import BatchTable
    from hir_plugins.commands.batch.resource_requests import build_requests
    from hir_plugins.commands.batch.scheduling.capture_arguments import expand_patterns, read_capture_list
    from hir_plugins.commands.batch.scheduling.driver import Batch

    all_assignments = list(assignments)
    if plugin_files:
        absolute = [str(Path(name).resolve()) if name.endswith(".py") else name for name in plugin_files]
        all_assignments.append(f"plugins={json.dumps(absolute)}")
    plugins = PluginManager.discover(plugin_files)
    config = load_config(plugins, preset, config_file, all_assignments, deterministic=deterministic or None)
    names = [*expand_patterns(captures), *(line for file in lists for line in read_capture_list(file))]
    options = BatchOptions(
        config=config,
        requests=build_requests(cpus, gpus, requests),
        address=address,
        attempts=attempts,
        retry_failed=retry_failed,
        max_in_progress=max_in_progress,
        keep_stages=not drop_stages,
        cache=cache and cache.resolve(),  # workers have other working directories
    )
    stdout = sys.stdout
    try:
        # Ray prints long messages about workers that die; the batch reports them in one sentence
        with (
            _interruptible(),
            BatchTable(quiet=quiet or as_json) as table,
            open(os.devnull, "w") as null,
            contextlib.redirect_stdout(sys.stderr if verbose else null),
        ):
            on_event = partial(print_event, stdout) if as_json else table.event
            batch = Batch(names, destination, options, on_event, table.update)
            jobs = batch.run()
    except KeyboardInterrupt:
        click.echo("hir: interrupted; repeat the call to continue", err=True)
        raise click.exceptions.Exit(EXIT_INTERRUPTED) from None
    failed = [job for job in jobs if job.state == "failed"]
    if not quiet and not as_json:
        click.echo(f"{len(jobs) - len(failed)} done, {len(failed)} failed")
        click.echo(f"{'results':>8}  {batch.destination.root}")
        click.echo(f"{'summary':>8}  {batch.destination.page}")
    for job in failed:
        click.echo(on_one_line(f"hir: {job.name}: {job.reason} (log: {batch.destination.log(job.name)})"), err=True)
    if failed:
        raise click.exceptions.Exit(EXIT_SOME_FAILED)


def print_event(stream: TextIO, event: BatchEvent) -> None:
    """Writes the event as one line of JSON."""
    document: dict[str, Any] = {"time": round(time.time(), 3), "event": event.name}
    if event.capture:
        document["capture"] = event.capture
    print(json.dumps(document | dict(event.details)), file=stream, flush=True)


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Treats SIGTERM, with which clusters end jobs, as Ctrl-C.

    `hir` ends its process 1.5 s after Ctrl-C at the latest. The batch needs longer to cancel its tasks, to stop Ray
    and to write batch.json, so that limit is switched off meanwhile.
    """
    handler = signal.signal(signal.SIGTERM, _interrupt)
    wakeup_fd = signal.set_wakeup_fd(-1)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, handler)
        signal.set_wakeup_fd(wakeup_fd)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
