"""Prints what is wrong with plugins; the command goes on without them."""

from __future__ import annotations

from collections.abc import Iterable

import click


def echo_problems(problems: Iterable[str]) -> None:
    """One line on standard error for each problem."""
    for problem in problems:
        click.echo(f"hir: plugin problem: {problem}", err=True)
