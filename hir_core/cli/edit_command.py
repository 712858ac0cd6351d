"""`hir edit`: changes material or light of a finished asset."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages


@click.command("edit")
@click.argument("source", type=FOLDER, metavar="RUN")
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Scene folder to write.")
@click.option("--roughness", type=float, default=1.0, metavar="FACTOR", help="Factor of the perceptual roughness √α.")
@click.option(
    "--tint",
    type=(float, float, float),
    default=(1.0, 1.0, 1.0),
    metavar="R G B",
    help="Factors of the diffuse albedo (of the base colour in `metallic`), linear RGB.",
)
@click.option(
    "--specular", type=float, default=1.0, metavar="FACTOR", help="Factor of the specular albedo (of F0 in `metallic`)."
)
@click.option("--metalness", type=float, default=1.0, metavar="FACTOR", help="Factor of the metalness (`metallic`).")
@click.option(
    "--light",
    default="",
    metavar="FILE[*STRENGTH]",
    help="A lat-long .hdr or .exr in the asset's axes (+Y up) in place of its light.",
)
@click.option("--picture/--no-picture", default=True, help="Write DIR.png: renders before and after; on by default.")
@click.option(
    "--size", type=click.IntRange(min=16, max=4096), default=512, show_default=True, help="Side of each render, pixels."
)
@plugin_option
@verbosity_options
def edit_command(
    source: Path,
    output: Path,
    roughness: float,
    tint: tuple[float, float, float],
    specular: float,
    metalness: float,
    light: str,
    picture: bool,
    size: int,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Changes the material or light of RUN and writes the result as a scene folder for hir export and hir view.

    The run itself is not changed.
    """
    require_reconstruction_packages("hir edit")
    from hir_core.errors import ConfigError, InputError
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.asset_edit import AssetEdit, edit_run
    from hir_core.terminal.run_results import say_earlier_scene

    edit = AssetEdit(roughness, tint, specular, light, metalness)
    if edit == AssetEdit():
        raise ConfigError("nothing would change; give --roughness, --tint, --specular, --metalness or --light")
    with suppress(InputError):  # a damaged run.json does not keep a scene from being edited
        say_earlier_scene(source, "the edit starts from")
    for path in edit_run(source, edit, output, PluginManager.discover(plugin_files), picture, size):
        if not quiet:
            click.echo(str(path))
