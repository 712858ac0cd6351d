"""`hir config`: prints the settings and their schema."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from hir_core.terminal.command_options import plugin_option, settings_options


@click.group("config")
def config_group() -> None:
    """Prints the settings of a run, or their JSON schema."""


@config_group.command("show")
@settings_options
@plugin_option
def show_command(
    preset: str, config_file: Path | None, assignments: tuple[str, ...], plugin_files: tuple[str, ...]
) -> None:
    """Prints all settings as TOML: preset, file and --set merged. `hir reconstruct --config` reads the output."""
    import tomli_w

    from hir_core.config import load_config
    from hir_core.plugins.manager import PluginManager

    plugins = PluginManager.discover(plugin_files)
    config = load_config(plugins, preset, config_file, assignments, plugins=plugin_files or None)
    click.echo(tomli_w.dumps({key: _plain(value) for key, value in asdict(config).items()}), nl=False)


@config_group.command("schema")
@plugin_option
def schema_command(plugin_files: tuple[str, ...]) -> None:
    """Prints the JSON schema of the settings and of the options of every component."""
    from hir_core.config import RunConfig
    from hir_core.plugins.manager import PluginManager
    from hir_core.plugins.options import options_schema

    plugins = PluginManager.discover(plugin_files)
    components: dict[str, dict[str, Any]] = {}
    for r in plugins.components():
        components.setdefault(r.kind, {})[r.component.name] = options_schema(r.component.config)
    schema = {
        "settings": options_schema(RunConfig),
        "components": components,
        "observers": {name: options_schema(options) for name, options in plugins.observers().items()},
    }
    click.echo(json.dumps(schema, indent=2))


def _plain(value: object) -> object:
    """Tuples as lists, which TOML has."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
