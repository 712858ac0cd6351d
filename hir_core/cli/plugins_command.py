"""`hir plugins`: lists the installed components, or prints the options of one."""

from __future__ import annotations

import json

import click

from hir_core.plugins.loading import docs_page
from hir_core.terminal.command_options import plugin_option
from hir_core.terminal.plugin_problems import echo_problems


@click.command("plugins")
@click.argument("name", required=False, default="")
@click.option("--docs", "with_docs", is_flag=True, help="Print the page of NAME, too, where its plugin has one.")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
@plugin_option
def plugins_command(name: str, with_docs: bool, as_json: bool, plugin_files: tuple[str, ...]) -> None:
    """Lists the installed components, and what to install for those whose packages are missing.

    With NAME, a component, KIND:COMPONENT, observer, preset, command or distribution: its options with their units and
    ranges, its traits and its page.
    """
    from hir_core.errors import ConfigError
    from hir_core.plugins.manager import PluginManager

    manager = PluginManager.discover(plugin_files)
    manager.commands()
    if name:
        from hir_core.cli.plugin_details import details

        if as_json:
            raise ConfigError("--json prints the list of all components; leave out NAME, or use `hir config schema`")
        click.echo(details(name, manager, with_docs))
        return
    if with_docs:
        raise ConfigError("--docs prints the page of one component; name it: hir plugins NAME --docs")
    rows = [
        {
            "kind": r.kind,
            "name": r.component.name,
            "summary": r.component.summary,
            "distribution": r.distribution,
            "version": r.version,
            "traits": sorted(r.component.traits),
            "docs": str(docs_page(r.component.docs)) if r.component.docs else None,
            "missing": list(r.missing),
            "install": r.install_command if r.missing else None,
        }
        for r in manager.components()
    ]
    if as_json:
        presets = {name: str(path) for name, path in manager.presets().items()}
        document = {
            "components": rows,
            "presets": presets,
            "observers": list(manager.observers()),
            "commands": list(manager.commands()),
            "problems": manager.problems,
            "notices": manager.notices,
        }
        click.echo(json.dumps(document, indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table("kind", "name", "what it does", "from", "state", box=None, padding=(0, 2, 0, 0))
    previous = ""
    for row in rows:
        kind = str(row["kind"])
        state = f"needs {', '.join(row['missing'])}: {row['install']}" if row["missing"] else "installed"
        table.add_row(
            "" if kind == previous else kind.replace("_", " "),
            str(row["name"]),
            str(row["summary"]),
            f"{row['distribution']} {row['version']}".strip(),
            state.replace("[", "\\["),
        )
        previous = kind
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=200)  # into a file or a pipe: one line each
    console.print(table)
    console.print(f"presets: {', '.join(manager.presets()) or 'none'}")
    console.print(f"observers: {', '.join(manager.observers()) or 'none'}")
    console.print(f"commands: {', '.join(sorted(manager.commands())) or 'none'}")
    echo_problems(manager.problems)
    for notice in manager.notices:
        click.echo(f"hir: plugin notice: {notice}", err=True)
