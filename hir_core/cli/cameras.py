"""`hir cameras`."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.cli.options import FOLDER, plugin_option


@click.command("cameras")
@click.argument("run", type=FOLDER)
@click.option("-f", "--format", "form", default="transforms", show_default=True, help="transforms or colmap.")
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Where the files go.")
@plugin_option
def cameras_command(run: Path, form: str, output: Path, plugin_files: tuple[str, ...]) -> None:
    """Writes the cameras that RUN solved, for other programs: transforms.json, or a COLMAP model as text."""
    from hir_core.capture.capture_store import read_cameras
    from hir_core.errors import InputError
    from hir_core.files.json_documents import read_json
    from hir_core.intake.camera_export import export_cameras
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.run_directory import open_run

    directory = open_run(run)
    told = read_json(directory.path / "run.json")["capture"]
    capture = read_capture(Path(told["path"]), told["split"], PluginManager.discover(plugin_files), told["reader"])
    cameras = read_cameras(directory.cameras)
    if not cameras:
        raise InputError(f"{directory.cameras} holds no solved camera")
    photographs = {view.name: view.path for view in capture.views if view.path is not None}
    click.echo(str(export_cameras(cameras, photographs, form, output)))
