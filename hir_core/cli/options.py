"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., Any])

FOLDER: Any = click.Path(path_type=Path)


def plugin_option(function: Function) -> Function:
    """`--plugin FILE`, as often as needed."""
    return click.option(
        "--plugin",
        "plugin_files",
        multiple=True,
        metavar="FILE",
        help="A plugin beside the installed ones: a .py file or a module. Its code runs.",
    )(function)


def loudness_options(function: Function) -> Function:
    """`-q` and `-v`."""
    function = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors and what was asked for.")(
        function
    )
    return click.option("-v", "--verbose", is_flag=True, help="Print more, and where an error happened.")(function)


def settings_options(function: Function) -> Function:
    """`--preset`, `--config` and `--set`."""
    function = click.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="KEY=VALUE",
        help="One setting, such as geometry.regularizers.laplacian.weight=2.",
    )(function)
    function = click.option("--config", "config_file", type=FOLDER, metavar="FILE", help="A TOML file of settings.")(
        function
    )
    return click.option(
        "--preset",
        default="",
        metavar="NAME",
        help="Settings to start from: fast (default), best, paper, or a plugin's.",
    )(function)
