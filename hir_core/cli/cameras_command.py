"""`hir cameras`: writes the solved cameras for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.terminal.command_options import FOLDER, plugin_option


@click.command("cameras")
@click.argument("run", type=FOLDER)
@click.option("-f", "--format", "file_format", default="transforms", show_default=True, help="transforms or colmap.")
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Folder for the files.")
@plugin_option
def cameras_command(run: Path, file_format: str, output: Path, plugin_files: tuple[str, ...]) -> None:
    """Writes the solved cameras of RUN for other programs, as transforms.json or as a COLMAP text model.

    Files of other cameras in DIR are not overwritten.
    """
    from hir_core.errors import InputError
    from hir_core.files.json_documents import read_json
    from hir_core.intake.camera_export import export_cameras
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.capture_store import read_cameras
    from hir_core.run.run_directory import open_run

    directory = open_run(run)
    entry = read_json(directory.path / "run.json")["capture"]
    capture = read_capture(Path(entry["path"]), entry["split"], PluginManager.discover(plugin_files), entry["reader"])
    cameras = read_cameras(directory.cameras)
    if not cameras:
        raise InputError(f"{directory.cameras} has no solved camera; let the initializer stage of the run finish")
    photographs = {view.name: view.path for view in capture.views if view.path is not None}
    takes = {view.name: view.take for view in capture.views}
    click.echo(str(export_cameras(cameras, photographs, file_format, output, takes)))
