"""Would replace a command of hir."""

from __future__ import annotations

import click

from hir_core.plugins import hookimpl


@click.command("export")
def export_command() -> None:
    """Writes my own format."""


@hookimpl
def hir_register_commands(cli: click.Group) -> None:
    cli.add_command(export_command)
