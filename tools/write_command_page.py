"""Writes docs/command-line.md from the commands themselves; a test compares."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.cli.app import cli

PAGE = Path(__file__).resolve().parent.parent / "docs" / "command-line.md"

INTRODUCTION = """# The command line

Written by `python tools/write_command_page.py` from the commands themselves. Exit codes: 0 for success;
1 for a bug (of `hir doctor`: a check failed); 2 for an error that you can correct, described in one sentence; 3 if
captures of `hir batch` failed; 130 when interrupted.
`-v` shows the traceback of an error.
"""


def page() -> str:
    """Help of every command of the engine and of the built-in plugins."""
    parts = [INTRODUCTION]
    context = click.Context(cli, info_name="hir", max_content_width=110, terminal_width=110)
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        if (command.callback or cli.callback).__module__.startswith(("hir_core.", "hir_plugins.")):
            parts += _help(command, name, context)
    return "\n".join(parts)


def _help(command: click.Command, name: str, parent: click.Context) -> list[str]:
    context = click.Context(command, info_name=name, parent=parent, max_content_width=110, terminal_width=110)
    parts = [f"## hir {context.command_path.removeprefix('hir ')}\n```\n{command.get_help(context)}\n```\n"]
    if isinstance(command, click.Group):
        for sub in command.list_commands(context):
            found = command.get_command(context, sub)
            assert found is not None
            parts += _help(found, sub, context)
    return parts


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
