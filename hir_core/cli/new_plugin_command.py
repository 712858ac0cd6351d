"""`hir new-plugin`: writes a plugin to start from."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.plugins.manager import KINDS, PluginManager
from hir_core.terminal.command_options import FOLDER


@click.command("new-plugin")
@click.argument("name")
@click.option(
    "--kind",
    type=click.Choice([*(k.replace("_", "-") for k in KINDS), "observer", "command"]),
    default="regularizer",
    show_default=True,
    help="Kind of the plugin.",
)
@click.option(
    "--one-file", is_flag=True, help="Write one .py file for --plugin in place of a package; no observer or command."
)
@click.option("-o", "--output", type=FOLDER, default=Path(), metavar="DIR", help="Parent folder.")
def new_plugin_command(name: str, kind: str, one_file: bool, output: Path) -> None:
    """Writes an installable plugin NAME of one kind that passes the contract tests."""
    from hir_core.errors import ConfigError
    from hir_core.scaffold import HOOK_TEMPLATES, refuse_taken_name, write_one_file, write_plugin

    refuse_taken_name(name, kind.replace("-", "_"), PluginManager.discover())
    if one_file:
        if kind in HOOK_TEMPLATES:
            raise ConfigError(f"--one-file does not write the kind {kind}; remove --one-file")
        path, use = write_one_file(name, kind.replace("-", "_"), output)
        click.echo(path)
        click.echo(f"check it with:  hir check-plugin {path}")
        click.echo(f"use it with:    {use}")
        return
    written = write_plugin(name, kind.replace("-", "_"), output)
    folder = next(file.parent for file in written if file.name == "pyproject.toml")
    for file in written:
        click.echo(file)
    click.echo(f"install it with:  pip install -e {folder}")
    click.echo(f"check it with:    hir check-plugin {folder.name}")
