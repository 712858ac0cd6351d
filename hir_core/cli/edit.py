"""`hir edit`."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option


@click.command("edit")
@click.argument("source", type=FOLDER, metavar="RUN")
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="The scene folder to write.")
@click.option("--roughness", type=float, default=1.0, metavar="FACTOR", help="Of the roughness that engines show, √α.")
@click.option(
    "--tint",
    type=(float, float, float),
    default=(1.0, 1.0, 1.0),
    metavar="R G B",
    help="Factors of the diffuse albedo, linear.",
)
@click.option("--specular", type=float, default=1.0, metavar="FACTOR", help="Of the specular albedo.")
@click.option(
    "--light", default="", metavar="FILE[*STRENGTH]", help="A lat-long .hdr or .exr in the asset's axes (+Y up)."
)
@click.option(
    "--picture/--no-picture", default=True, help="Write DIR.png: before and after, path traced; on by default."
)
@click.option(
    "--size", type=click.IntRange(min=16, max=4096), default=512, show_default=True, help="Of each half, pixels."
)
@plugin_option
@loudness_options
def edit_command(
    source: Path,
    output: Path,
    roughness: float,
    tint: tuple[float, float, float],
    specular: float,
    light: str,
    picture: bool,
    size: int,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Changes RUN's material or light and writes the result as a scene folder for hir export and hir view.

    The run itself stays as it is.
    """
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.asset_edit import Edit, edit_run

    edit = Edit(roughness, tint, specular, light)
    for path in edit_run(source, edit, output, PluginManager.discover(plugin_files), picture, size):
        if not quiet:
            click.echo(str(path))
