"""`hir batch`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TextIO

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option, settings_options

if TYPE_CHECKING:
    from hir_plugins.commands.batch.scheduling.events import Event

SOME_FAILED = 3


@click.command("batch")
@click.argument("captures", nargs=-1, metavar="CAPTURES...")
@click.option("-o", "--output", "destination", required=True, metavar="DEST", help="A folder or URL for the results.")
@click.option("--from", "lists", multiple=True, metavar="FILE", help="A file or URL with one capture a line.")
@click.option("--address", default="auto", show_default=True, help="auto, local, ray://HOST:PORT or HOST:PORT.")
@settings_options
@click.option("--cpus", type=click.FloatRange(min=0), default=1.0, show_default=True, help="Cores of each task.")
@click.option(
    "--gpus",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    help="GPUs, or a share of one, of each task that computes on it.",
)
@click.option(
    "--request",
    "requests",
    multiple=True,
    metavar="KEY=VALUE",
    help="Of one group of stages, such as reflectance.memory_gib=6 or export.cpus=2.",
)
@click.option(
    "--tries",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="Times a task is begun when workers, nodes or the store fail.",
)
@click.option(
    "--at-once",
    type=click.IntRange(min=0),
    default=0,
    help="Captures in progress together; as many as there is room for by default.",
)
@click.option("--retry-failed", is_flag=True, help="Work again on captures that failed in an earlier call.")
@click.option("--drop-stages", is_flag=True, help="Leave what each stage left out of the results.")
@click.option("--cache", type=FOLDER, metavar="DIR", help="Where workers stage files; temporary files by default.")
@click.option("--deterministic", is_flag=True, help="The same files for the same input and machine; slower.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for each event.")
@plugin_option
@loudness_options
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
    tries: int,
    at_once: int,
    retry_failed: bool,
    drop_stages: bool,
    cache: Path | None,
    deterministic: bool,
    as_json: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Reconstructs many CAPTURES on Ray, into DEST: a run for each, batch.json and batch.html.

    CAPTURES and DEST are folders or URLs (s3://…, gs://…). The same call again goes on: what is finished stays.
    Exit code 3: some captures failed.
    """
    from hir_core.config import load_config
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.batch.batch_options import Options
    from hir_plugins.commands.batch.progress_table import BatchTable
    from hir_plugins.commands.batch.scheduling.capture_status import expand, read_list
    from hir_plugins.commands.batch.scheduling.driver import Batch
    from hir_plugins.commands.batch.stage_groups import build_requests

    chosen = list(assignments)
    if plugin_files:
        named = [str(Path(name).resolve()) if name.endswith(".py") else name for name in plugin_files]
        chosen.append(f"plugins={json.dumps(named)}")
    plugins = PluginManager.discover(plugin_files)
    config = load_config(plugins, preset, config_file, chosen, deterministic=deterministic or None)
    words = [*expand(captures), *(line for name in lists for line in read_list(name))]
    options = Options(
        config,
        build_requests(cpus, gpus, requests),
        address,
        tries,
        retry_failed,
        at_once,
        not drop_stages,
        cache and cache.resolve(),  # workers have folders of their own that they are in
    )
    before = signal.signal(signal.SIGTERM, _interrupt)  # clusters end jobs so
    # `hir` leaves 1.5 s after Ctrl-C whatever happens; to end tasks and Ray and to write batch.json takes longer
    watched = signal.set_wakeup_fd(-1)
    out = sys.stdout
    try:
        # Ray prints pages about a worker that died; what it means for the batch is said in a sentence
        with (
            BatchTable(quiet=quiet or as_json) as table,
            open(os.devnull, "w") as nowhere,
            contextlib.redirect_stdout(sys.stderr if verbose else nowhere),
        ):
            told = partial(print_event, out) if as_json else table.event
            batch = Batch(words, destination, options, told, table.update)
            chains = batch.run()
    except KeyboardInterrupt:
        click.echo("hir: interrupted; the same call goes on where it was", err=True)
        raise click.exceptions.Exit(130) from None
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.set_wakeup_fd(watched)
    failed = [chain for chain in chains if chain.state == "failed"]
    if not quiet and not as_json:
        click.echo(f"{len(chains) - len(failed)} done, {len(failed)} failed")
        click.echo(f"{'results':>8}  {batch.destination.root}")
        click.echo(f"{'summary':>8}  {batch.destination.page}")
    for chain in failed:
        click.echo(f"hir: {chain.name}: {chain.reason} (log: {batch.destination.log(chain.name)})", err=True)
    if failed:
        raise click.exceptions.Exit(SOME_FAILED)


def print_event(out: TextIO, event: Event) -> None:
    """One line of JSON."""
    document: dict[str, Any] = {"time": round(time.time(), 3), "event": event.name}
    if event.capture:
        document["capture"] = event.capture
    print(json.dumps(document | dict(event.facts)), file=out, flush=True)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
