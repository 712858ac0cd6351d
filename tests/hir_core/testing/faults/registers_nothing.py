"""Has a command, and no @hookimpl above the function that adds it."""

from __future__ import annotations

import click


@click.command("count")
def count_command() -> None:
    """Counts something."""


def hir_register_commands(cli: click.Group) -> None:
    cli.add_command(count_command)
