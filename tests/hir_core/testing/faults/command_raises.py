"""Reads the run that it is given without looking whether it is there."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.plugins import hookimpl


@click.command("views-of")
@click.argument("run", type=click.Path(path_type=Path))
def views_of_command(run: Path) -> None:
    """Counts the views of RUN."""
    click.echo((run / "views.json").read_text(encoding="utf-8").count("name"))


@hookimpl
def hir_register_commands(cli: click.Group) -> None:
    cli.add_command(views_of_command)
