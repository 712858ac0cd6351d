"""`hir delight`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hir_core.errors import InputError
from hir_core.plugins.options import MAX_SEED
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages
from hir_core.terminal.run_results import show_summary

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

PRESET = "delight"


@click.command("delight")
@click.argument("scan", type=FOLDER)
@click.argument("photos", type=FOLDER)
@click.option("-o", "--output", "run", type=FOLDER, required=True, metavar="RUN", help="Folder of the run.")
@click.option(
    "--axes",
    type=click.Choice(["auto", "source", "source_y_up", "world"]),
    default="auto",
    help="Axes of the scan: source are those of the cameras' file, source_y_up are these turned from +Z up to +Y up, "
    "world are those of a run's results; auto takes source, and compares all three for glTF.",
)
@click.option(
    "--align/--no-align",
    default=None,
    help="Move the scan onto points of the photographs; on by default where the photographs have no cameras.",
)
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="One setting; repeatable.")
@click.option("--resume", is_flag=True, help="Continue a run: reuse finished stages whose settings are unchanged.")
@click.option("--seed", type=click.IntRange(0, MAX_SEED), help="Seed of all random numbers.")
@plugin_option
@verbosity_options
def delight_command(
    scan: Path,
    photos: Path,
    run: Path,
    axes: str,
    align: bool | None,
    assignments: tuple[str, ...],
    resume: bool,
    seed: int | None,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Replaces the baked texture of SCAN by PBR textures and a light, found in the photographs of the folder PHOTOS.

    The mesh and its texture coordinates stay. Cameras come from the file of the scanning program in PHOTOS
    (docs/captures.md); without one they are estimated, and the scan is aligned with them. This is `hir reconstruct`
    with the preset delight.
    """
    if not scan.is_file():
        problem = "is a folder" if scan.is_dir() else "does not exist"
        raise InputError(f"{scan} {problem}; give the mesh file of the scan, such as scan.obj")
    require_reconstruction_packages("hir delight")
    from hir_core.pipeline import reconstruct
    from hir_core.plugins.manager import PluginManager
    from hir_core.terminal.progress_bar import ProgressBar

    plugins = PluginManager.discover(plugin_files)
    with ProgressBar(quiet=quiet) as bar:
        result = reconstruct(
            photos,
            run,
            preset=PRESET,
            assignments=[*scan_settings(scan, photos, axes, align, plugins), *assignments],
            resume=resume,
            seed=seed,
            plugins=plugins,
            on_progress=bar.update,
            on_message=bar.message,
        )
    if not quiet:
        show_summary(result.directory)


def scan_settings(scan: Path, photos: Path, axes: str, align: bool | None, plugins: PluginManager) -> list[str]:
    """The settings beside those of the preset: where the scan is, and how it comes into the world of the cameras."""
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.run.python_warnings import forward_user_warnings

    with forward_user_warnings(lambda sentence: None):  # the run says them
        views = read_capture(photos, "train", plugins).views
    known = bool(views) and all(view.camera is not None for view in views)
    settings = [f"initializer.mesh_file.path={json.dumps(str(scan.resolve()))}", f'initializer.mesh_file.axes="{axes}"']
    align = not known if align is None else align
    if align or not known:
        settings.append('initializers=["colmap", "mesh_file"]')
    if align:
        settings.append('initializer.mesh_file.align="points"')
    return settings
