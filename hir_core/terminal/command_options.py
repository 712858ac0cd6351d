"""Command-line options that several commands have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., object])


class _NamedPath(click.Path):
    """A path that is not empty: pathlib takes an empty one, such as an unset variable of a script, for the current
    folder.
    """

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("the path is empty; give a path, or . for the current folder", param, ctx)
        return super().convert(value, param, ctx)


FOLDER = _NamedPath(path_type=Path)


def plugin_option(function: Function) -> Function:
    """`--plugin FILE`, repeatable."""
    return click.option(
        "--plugin",
        "plugin_files",
        multiple=True,
        metavar="FILE",
        help="An additional plugin: a .py file or a module; repeatable. Its code is executed.",
    )(function)


def verbosity_options(function: Function) -> Function:
    """`-q` and `-v`."""
    function = click.option("-q", "--quiet", is_flag=True, help="Print only errors and the requested output.")(function)
    return click.option("-v", "--verbose", is_flag=True, help="Print more, and the traceback of an error.")(function)


def settings_options(function: Function) -> Function:
    """`--preset`, `--config` and `--set`."""
    function = click.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="KEY=VALUE",
        help="One setting, such as geometry.iterations=200; repeatable.",
    )(function)
    function = click.option("--config", "config_file", type=FOLDER, metavar="FILE", help="A TOML file of settings.")(
        function
    )
    return click.option(
        "--preset",
        default="",
        metavar="NAME",
        help="Preset of settings, such as draft, fast (default) or best; `hir plugins` lists them.",
    )(function)
