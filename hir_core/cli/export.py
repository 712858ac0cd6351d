"""`hir export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option
from hir_core.errors import ConfigError, InputError


@click.command("export")
@click.argument("run", type=FOLDER)
@click.option(
    "-f",
    "--format",
    "formats",
    multiple=True,
    required=True,
    metavar="NAME",
    help="A format, as often as needed: glb, gltf, usda, usdc, usdz, obj, hdr, exr, or a plugin's.",
)
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Where the files go.")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="An option of a format, such as glb.max_texture_size=1024.",
)
@click.option(
    "--verify/--no-verify",
    default=True,
    help="Read each file back and, for a run, render it again beside the fitted scene; on by default.",
)
@plugin_option
@loudness_options
def export_command(
    run: Path,
    formats: tuple[str, ...],
    output: Path,
    assignments: tuple[str, ...],
    verify: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Writes the asset of RUN (a run, or a scene folder) in other formats."""
    from hir_exporters.exporter import ExportReport
    from hir_exporters.scene_files import load_scene

    from hir_core.config import assign
    from hir_core.export import export_asset
    from hir_core.manager import PluginManager

    plugins = PluginManager.discover(plugin_files)
    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    for name, table in options.items():
        if not isinstance(table, dict):
            raise ConfigError(
                f"--set {name}={table}: name the format and its option, such as --set glb.max_texture_size=1024"
            )
        plugins.find("exporter", name)
    asset = load_scene(scene_folder(run))

    def told(name: str, report: ExportReport) -> None:
        for warning in report.warnings:
            click.echo(f"hir: {name}: {warning}", err=True)
        if not quiet:
            for file in report.files:
                click.echo(f"{file}  {file.stat().st_size / 1e6:.2f} MB")

    reports = export_asset(asset, list(dict.fromkeys(formats)), output, plugins, options, told)
    if verify:
        from hir_core.verify import rerender_of_run, verify_export

        rerender, why_not = rerender_of_run(run, asset, plugins)
        for name, report in reports.items():
            found = verify_export(report, asset, options.get(name), rerender, why_not)
            for warning in found.warnings:
                click.echo(f"hir: {name}: {warning}", err=True)
            if not quiet:
                click.echo(f"{name}: {found.sentence()}")


def scene_folder(run: Path) -> Path:
    """The scene of a run's folder, or the folder itself where it is a scene."""
    if (run / "scene.json").is_file():
        return run
    if (run / "scene" / "scene.json").is_file():
        return run / "scene"
    if not run.is_dir():
        raise InputError(f"{run} is not a folder; give the folder of a run or of a scene")
    raise InputError(f"{run} holds no finished scene; finish the run with: hir reconstruct … --resume")
