"""`hir export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option
from hir_core.errors import ConfigError, InputError

if TYPE_CHECKING:
    from hir_exporters.asset import Asset

    from hir_core.plugins.manager import PluginManager

PROFILES = ("khr", "blender", "metalrough", "unity-legacy")
BUDGETS = ("none", "quicklook", "web", "desktop")


@click.command("export")
@click.argument("source", type=FOLDER, metavar="RUN|SCENE|MESH")
@click.option(
    "-f",
    "--format",
    "formats",
    multiple=True,
    required=True,
    metavar="NAME",
    help="A format, as often as needed: glb, gltf, usda, usdc, usdz, obj, hdr, exr, …: `hir plugins` lists them.",
)
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Where the files go.")
@click.option("--profile", type=click.Choice(PROFILES), help="How glTF says the material: docs/engines says which.")
@click.option("--budget", type=click.Choice(BUDGETS), help="Bounds of a target on triangles and textures.")
@click.option("--lod", metavar="N,N,…", help="Levels of detail of glTF as triangle counts, such as 100k,20k,5k.")
@click.option("--base-color", metavar="FILE|R,G,B", help="Of a MESH: an sRGB image, or linear numbers.")
@click.option("--roughness", metavar="FILE|NUMBER", help="Of a MESH: perceptual, 0 to 1.")
@click.option("--metallic", metavar="FILE|NUMBER", help="Of a MESH: 0 to 1.")
@click.option("--normal", metavar="FILE", help="Of a MESH: tangent space normals, green up.")
@click.option("--light", type=FOLDER, metavar="FILE", help="Of a MESH: a lat-long .hdr or .exr.")
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
    source: Path,
    formats: tuple[str, ...],
    output: Path,
    profile: str | None,
    budget: str | None,
    lod: str | None,
    base_color: str | None,
    roughness: str | None,
    metallic: str | None,
    normal: str | None,
    light: Path | None,
    assignments: tuple[str, ...],
    verify: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Writes an asset in other formats: that of a run, of a scene folder, or a mesh with textures.

    A MESH is an .obj, .ply, .glb, .gltf or USD file with texture coordinates; it brings its material, or is given one.
    """
    from concurrent.futures import ThreadPoolExecutor

    from hir_exporters.exporter import ExportReport
    from hir_exporters.formats import import_writers

    from hir_core.plugins.manager import PluginManager
    from hir_core.stages.export.asset_export import export_asset

    maps = {"base_color": base_color, "roughness": roughness, "metallic": metallic, "normal": normal}
    plugins = PluginManager.discover(plugin_files)
    wanted = list(dict.fromkeys(formats))
    options = _options(plugins, assignments, wanted, profile, budget, lod)
    with ThreadPoolExecutor(max_workers=1) as beside:
        reading = beside.submit(_asset, source, {n: text for n, text in maps.items() if text is not None}, light)
        import_writers(wanted)
        asset = reading.result()

    def told(name: str, report: ExportReport) -> None:
        for warning in report.warnings:
            click.echo(f"hir: {name}: {warning}", err=True)
        if not quiet:
            for file in report.files:
                click.echo(f"{file}  {file.stat().st_size / 1e6:.2f} MB")

    reports = export_asset(asset, wanted, output, plugins, options, told)
    if verify:
        from hir_core.stages.export.export_verification import rerender_of_run, verify_export

        rerender, why_not = rerender_of_run(source, asset, plugins)
        for name, report in reports.items():
            found = verify_export(report, asset, options.get(name), rerender, why_not)
            for warning in found.warnings:
                click.echo(f"hir: {name}: {warning}", err=True)
            if not quiet:
                click.echo(f"{name}: {found.sentence()}")


def _options(
    plugins: PluginManager,
    assignments: tuple[str, ...],
    formats: list[str],
    profile: str | None,
    budget: str | None,
    lod: str | None,
) -> dict[str, Any]:
    """Options by format: those of `--set`, then the short ones where a format has them."""
    from hir_core.config import assign

    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    for name, table in options.items():
        if not isinstance(table, dict):
            raise ConfigError(
                f"--set {name}={table}: name the format and its option, such as --set glb.max_texture_size=1024"
            )
        plugins.find("exporter", name)
    short = {"profile": profile, "budget": budget, "lods": None if lod is None else parse_lods(lod)}
    for key, value in short.items():
        if value is None:
            continue
        takers = [n for n in formats if key in _fields(plugins, n)]
        if not takers:
            flag = {"lods": "--lod"}.get(key, f"--{key}")
            raise ConfigError(f"{flag}: none of the formats {', '.join(formats)} has it; leave it out, or add -f glb")
        for name in takers:
            options.setdefault(name, {}).setdefault(key, value)
    return options


def _fields(plugins: PluginManager, name: str) -> dict[str, Any]:
    return getattr(plugins.find("exporter", name).component.config, "__dataclass_fields__", {})


def parse_lods(text: str) -> list[int]:
    """Triangle counts from `100k,20k,5000`. Raises `ConfigError`."""
    counts = []
    for part in text.split(","):
        number, scale = (part[:-1], 1000) if part.strip().lower().endswith("k") else (part, 1)
        try:
            count = round(float(number) * scale)
        except (ValueError, OverflowError):
            count = 0
        if count < 1:
            raise ConfigError(f"--lod {text}: {part!r} is no number of triangles; write such as 100k,20k,5k")
        counts.append(count)
    return counts


def _asset(source: Path, maps: dict[str, str], light: Path | None) -> Asset:
    from hir_exporters.scene_format import load_scene

    if source.is_file():
        from hir_exporters.reading.mesh_import import SurfaceMaps, load_mesh_asset, parse_map

        return load_mesh_asset(source, SurfaceMaps(**{n: parse_map(n, text) for n, text in maps.items()}), light)
    if maps or light is not None:
        given = ", ".join([*(f"--{name.replace('_', '-')}" for name in maps), *(["--light"] if light else [])])
        raise InputError(f"{source} is no mesh file, and {given} go with a mesh such as model.obj")
    return load_scene(scene_folder(source))


def scene_folder(run: Path) -> Path:
    """The scene of a run's folder, or the folder itself where it is a scene."""
    if (run / "scene.json").is_file():
        return run
    if (run / "scene" / "scene.json").is_file():
        return run / "scene"
    if not run.is_dir():
        raise InputError(f"{run} is not there; give the folder of a run or of a scene, or a mesh file")
    raise InputError(f"{run} holds no finished scene; finish the run with: hir reconstruct … --resume")
