"""`hir render`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option


@click.command("render")
@click.argument("run", type=FOLDER)
@click.option("--view", "views", multiple=True, metavar="NAME", help="A photograph of the run, as often as needed.")
@click.option("--orbit", type=click.IntRange(min=1), metavar="N", help="N pictures around the object.")
@click.option(
    "--elevation", type=click.FloatRange(-89, 89), default=20.0, show_default=True, help="Degrees, of --orbit."
)
@click.option(
    "--size", type=click.IntRange(min=16, max=8192), default=512, show_default=True, help="Of --orbit, pixels."
)
@click.option("--relight", default="", metavar="FILE[*STRENGTH]", help="A lat-long light in the asset's axes (+Y up).")
@click.option("--renderer", default="", metavar="NAME", help="The reference renderer unless another is named.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Such as render_samples=256.")
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Where the pictures go.")
@click.option("--exr", is_flag=True, help="Write linear premultiplied .exr beside each .png.")
@plugin_option
@loudness_options
def render_command(
    run: Path,
    views: tuple[str, ...],
    orbit: int | None,
    elevation: float,
    size: int,
    relight: str,
    renderer: str,
    assignments: tuple[str, ...],
    output: Path,
    exr: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Renders RUN from the places of its photographs, or all around it; PNGs are sRGB with alpha."""
    from hir_core.config import assign
    from hir_core.errors import ConfigError
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.run_directory import open_run

    if not views and orbit is None:
        raise ConfigError("say what to render: --view NAME, or --orbit N for N pictures around the object")
    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    directory = open_run(run)
    plugins = PluginManager.discover(plugin_files)
    from hir_core.rendering.run_pictures import render_pictures

    for path in render_pictures(
        directory, plugins, output, views, orbit or 0, elevation, size, relight, renderer, options, exr
    ):
        if not quiet:
            click.echo(str(path))
