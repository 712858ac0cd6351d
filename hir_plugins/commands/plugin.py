"""The built-in commands, and the page that displays an asset in a report. Heavy imports are inside the functions."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.plugins import hookimpl
from hir_plugins.commands.batch.command import batch_command
from hir_plugins.commands.bench.command import bench_command
from hir_plugins.commands.card.command import card_command
from hir_plugins.commands.delight.command import delight_command
from hir_plugins.commands.light_probe.command import light_probe_command
from hir_plugins.commands.ui.command import ui_command
from hir_plugins.commands.viewer.command import view_command


@hookimpl
def hir_register_commands(cli: click.Group) -> None:
    """Adds `hir batch`, `hir bench`, `hir card`, `hir delight`, `hir light-probe`, `hir ui` and `hir view`."""
    for command in (
        batch_command,
        bench_command,
        card_command,
        delight_command,
        light_probe_command,
        ui_command,
        view_command,
    ):
        cli.add_command(command)


@hookimpl
def hir_asset_page(run_folder: Path) -> str | None:
    """The page of `hir view`, without the photographs of the run."""
    from hir_plugins.commands.viewer.viewer_page import view_page

    return view_page(run_folder, photographs=False)
