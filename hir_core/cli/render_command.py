"""`hir render`: renders a finished run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages


@click.command("render")
@click.argument("run", type=FOLDER)
@click.option(
    "--view", "views", multiple=True, metavar="NAME", help="Render from the camera of this photograph; repeatable."
)
@click.option("--orbit", type=click.IntRange(min=1), metavar="N", help="Render from N cameras around the object.")
@click.option(
    "--elevation",
    type=click.FloatRange(-89, 89),
    default=20.0,
    show_default=True,
    help="Elevation of --orbit, degrees.",
)
@click.option(
    "--size",
    type=click.IntRange(min=16, max=8192),
    default=512,
    show_default=True,
    help="Image side of --orbit, pixels.",
)
@click.option(
    "--relight",
    default="",
    metavar="FILE[*STRENGTH]",
    help="Render under this lat-long light, in the asset's axes (+Y up).",
)
@click.option(
    "--renderer", default="", metavar="NAME", help="A reflectance renderer in place of the reference renderer."
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="An option of the renderer, such as render_samples=256; repeatable.",
)
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Folder for the images.")
@click.option("--exr", is_flag=True, help="Also write linear premultiplied .exr files.")
@plugin_option
@verbosity_options
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
    """Renders RUN from the cameras of its photographs or from an orbit. PNG files are sRGB with alpha."""
    require_reconstruction_packages("hir render")
    from hir_core.config import assign
    from hir_core.errors import ConfigError
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.run_directory import open_run

    if not views and orbit is None:
        raise ConfigError("choose what to render: --view NAME, or --orbit N for N images around the object")
    context = click.get_current_context()
    for name in ("elevation", "size"):
        if orbit is None and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise ConfigError(f"--{name} has no effect without --orbit; leave it out, or add --orbit N")
    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    directory = open_run(run)
    plugins = PluginManager.discover(plugin_files)
    from hir_core.report.run_pictures import render_pictures

    for path in render_pictures(
        directory, plugins, output, views, orbit or 0, elevation, size, relight, renderer, options, exr
    ):
        if not quiet:
            click.echo(str(path))
