"""`hir export`: writes an asset as glTF, USD, OBJ and light files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import click

from hir_core.errors import ConfigError, InputError
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options

if TYPE_CHECKING:
    from hir_exporters.asset import Asset

    from hir_core.plugins.manager import PluginManager

PROFILES = ("khr", "blender", "metalrough", "unity-legacy", "engine")
BUDGETS = ("none", "quicklook", "phone", "web", "desktop")
PIVOTS = ("source", "base", "centre")


@click.command("export")
@click.argument("source", type=FOLDER, metavar="RUN|SCENE|MESH")
@click.option(
    "-f",
    "--format",
    "formats",
    multiple=True,
    required=True,
    metavar="NAME",
    help="A format, such as glb, usdz or obj; repeatable. `hir plugins` lists all.",
)
@click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help="Folder for the files.")
@click.option(
    "--profile",
    type=click.Choice(PROFILES),
    help="Target of the glTF material, or engine for material and lights; docs/engines/ says which one to choose.",
)
@click.option(
    "--budget", type=click.Choice(BUDGETS), help="Limits of a target platform on triangles, texture size and bytes."
)
@click.option("--lod", metavar="N,N,…", help="glTF levels of detail as triangle counts, such as 100k,20k,5k.")
@click.option("--thumbnail", is_flag=True, help="Write a picture of the asset beside the file, in .usdz inside of it.")
@click.option("--height", type=float, metavar="METRES", help="Scale the asset to this height.")
@click.option("--scale", type=float, metavar="FACTOR", help="Scale the asset by this factor.")
@click.option(
    "--pivot",
    type=click.Choice(PIVOTS),
    default="source",
    help="Origin of the file: that of the asset (source), the middle of its lower side (base), or its centre.",
)
@click.option("--base-color", metavar="FILE|R,G,B", help="Base colour of a MESH: an sRGB image, or linear numbers.")
@click.option("--roughness", metavar="FILE|NUMBER", help="Perceptual roughness of a MESH, 0 to 1.")
@click.option("--metallic", metavar="FILE|NUMBER", help="Metalness of a MESH, 0 to 1.")
@click.option("--normal", metavar="FILE", help="Normal map of a MESH: tangent space, +Y (green up).")
@click.option("--light", type=FOLDER, metavar="FILE", help="Light for a MESH: a lat-long .hdr or .exr.")
@click.option("--take", metavar="NAME", help="Export the light of this take of a RUN; the first take by default.")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="An option of a format, such as glb.max_texture_size=1024; repeatable.",
)
@click.option(
    "--verify/--no-verify",
    default=True,
    help="Read each file back and, for a run, compare its render with that of the fitted scene; on by default.",
)
@plugin_option
@verbosity_options
def export_command(
    source: Path,
    formats: tuple[str, ...],
    output: Path,
    profile: str | None,
    budget: str | None,
    lod: str | None,
    thumbnail: bool,
    height: float | None,
    scale: float | None,
    pivot: Literal["source", "base", "centre"],
    base_color: str | None,
    roughness: str | None,
    metallic: str | None,
    normal: str | None,
    light: Path | None,
    take: str | None,
    assignments: tuple[str, ...],
    verify: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Writes the asset of a RUN, a SCENE folder or a MESH file in other formats.

    A MESH is an .obj, .ply, .glb, .gltf or USD file with texture coordinates. The material is that of the file (of an
    .obj that of its .mtl, of a .ply its texture), or that of the options. A warning names what is left out.
    """
    from hir_exporters.exporter import ExportReport
    from hir_exporters.mesh.placement import placed_asset, placement

    from hir_core.plugins.manager import PluginManager
    from hir_core.run.python_warnings import forward_user_warnings
    from hir_core.stages.export.asset_export import editors_of, export_asset

    maps = {"base_color": base_color, "roughness": roughness, "metallic": metallic, "normal": normal}
    plugins = PluginManager.discover(plugin_files)
    chosen = list(dict.fromkeys(formats))
    shortcuts = {
        "profile": profile,
        "budget": budget,
        "lods": None if lod is None else parse_lods(lod),
        "thumbnail": thumbnail or None,
    }
    options = _options(plugins, assignments, chosen, shortcuts)
    # not while another thread imports pxr: two extension modules that load at once can wait for each other for ever
    with forward_user_warnings(lambda text: click.echo(f"hir: {text}", err=True)):
        asset = _asset(source, {n: text for n, text in maps.items() if text is not None}, light)
    if take is not None:
        asset = _in_take(asset, source, take)
    matrix = placement(asset, scale, height, pivot)
    asset = placed_asset(asset, matrix)

    def print_files(name: str, report: ExportReport) -> None:
        for warning in report.warnings:
            click.echo(f"hir: {name}: {warning}", err=True)
        if not quiet:
            for file in report.files:
                click.echo(f"{file}  {file.stat().st_size / 1e6:.2f} MB")

    reports = export_asset(asset, chosen, output, plugins, options, print_files, _inputs(source, maps, light))
    if verify:
        from hir_exporters.engines.engine_shaders import EngineComparison

        from hir_core.stages.export.export_verification import rerender_of_run, verify_export

        rerender, why_not = rerender_of_run(source, asset, plugins, matrix)
        engines = EngineComparison(asset)
        if not quiet:
            from hir_exporters.asset_health import asset_health

            click.echo(f"asset: {asset_health(asset).sentence()}")
        for name, report in reports.items():
            hooks = editors_of(name, plugins)
            verification = verify_export(report, asset, options.get(name), rerender, why_not, engines, hooks)
            for warning in verification.warnings:
                click.echo(f"hir: {name}: {warning}", err=True)
            if not quiet:
                click.echo(f"{name}: {verification.sentence()}")


def _inputs(source: Path, maps: Mapping[str, str | None], light: Path | None) -> list[Path]:
    """The files of a MESH and of the options that replace parts of it."""
    from hir_exporters.reading.base_color_texture import named_files

    if not source.is_file():
        return []
    named = [] if source.suffix.lower().startswith(".usd") else named_files(source)
    given = [Path(text) for text in maps.values() if text is not None]
    return [source, *named, *given, *([] if light is None else [light])]


def _options(
    plugins: PluginManager,
    assignments: tuple[str, ...],
    formats: list[str],
    shortcuts: Mapping[str, Any],
) -> dict[str, Any]:
    """Options by format: those of `--set`, then `shortcuts` that are not None for the formats that have them."""
    from hir_core.config import assign

    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    for name, table in options.items():
        if not isinstance(table, dict):
            raise ConfigError(
                f"--set {name}={table}: name the format and its option, such as --set glb.max_texture_size=1024"
            )
        dotted = [r.component.name for r in plugins.components("exporter") if r.component.name.startswith(f"{name}.")]
        if dotted and name not in {r.component.name for r in plugins.components("exporter")}:
            raise ConfigError(f"--set {name}…: quote a name that contains a dot: --set '\"{dotted[0]}\".OPTION=VALUE'")
        plugins.find("exporter", name)
        if name not in formats:
            raise ConfigError(
                f"--set {name}.{next(iter(table), '')}: {name} is not written; add -f {name}, or remove it"
            )
    for key, value in shortcuts.items():
        if value is None:
            continue
        supporting = [n for n in formats if _allows(plugins, n, key, value)]
        flag = {"lods": "--lod"}.get(key, f"--{key}")
        for name in supporting:
            if options.get(name, {}).get(key, value) != value:
                raise ConfigError(f"{flag} and --set {name}.{key} differ; remove one of them")
        if not supporting:
            raise ConfigError(f"{flag}: no format of {', '.join(formats)} has this option; remove it, or add -f glb")
        for name in supporting:
            options.setdefault(name, {}).setdefault(key, value)
    return options


def _allows(plugins: PluginManager, name: str, key: str, value: Any) -> bool:
    """Whether the format has the option and, where it has a list of values, this value."""
    config = plugins.find("exporter", name).component.config
    if key not in getattr(config, "__dataclass_fields__", {}):
        return False
    hint = get_type_hints(config)[key]
    return get_origin(hint) is not Literal or value in get_args(hint)


def parse_lods(text: str) -> list[int]:
    """Triangle counts from `100k,20k,5000`. Raises `ConfigError`."""
    counts: list[int] = []
    for part in text.split(","):
        number, scale = (part[:-1], 1000) if part.strip().lower().endswith("k") else (part, 1)
        try:
            count = round(float(number) * scale)
        except (ValueError, OverflowError):
            count = 0
        if count < 1:
            raise ConfigError(f"--lod {text}: {part!r} is not a number of triangles; an example is 100k,20k,5k")
        if counts and count >= counts[-1]:
            raise ConfigError(
                f"--lod {text}: each level needs fewer triangles than the one before, such as 100k,20k,5k"
            )
        counts.append(count)
    return counts


def _asset(source: Path, maps: dict[str, str], light: Path | None) -> Asset:
    from hir_exporters.scene_format import load_scene

    if source.is_file():
        from hir_exporters.reading.material_overrides import parse_material_overrides
        from hir_exporters.reading.mesh_import import load_mesh_asset

        return load_mesh_asset(source, parse_material_overrides(maps), light)
    if maps or light is not None:
        options = ", ".join([*(f"--{name.replace('_', '-')}" for name in maps), *(["--light"] if light else [])])
        raise InputError(f"{source} is not a mesh file; {options} can only be used with a mesh file such as model.obj")
    folder = scene_folder(source)
    if folder != source:
        from hir_core.run.run_directory import refuse_links
        from hir_core.terminal.run_results import say_earlier_scene

        refuse_links(source)
        say_earlier_scene(source, "the files show")
    return load_scene(folder)


def _in_take(asset: Asset, run: Path, take: str) -> Asset:
    """The asset under the light of a take, whose radiance is in the same axes as that of the first."""
    from hir_core.files.stored_take_lights import read_take_lights
    from hir_core.run.run_directory import RunDirectory

    if not (run / "run.json").is_file():
        raise InputError(f"{run} is no run, so it has no takes; remove --take")
    lights = read_take_lights(RunDirectory(run).stage("reflectance") / "scene")
    if not lights or asset.environment is None:
        raise InputError(f"{run} was not made from several takes and has one light; remove --take")
    if take not in lights:
        raise InputError(f"{run} has no take {take!r}; its takes are {', '.join(repr(name) for name in lights)}")
    return replace(asset, environment=replace(asset.environment, radiance=lights[take]))


def scene_folder(run: Path) -> Path:
    """The scene folder of a run; `run` itself where it is a scene folder. `InputError` where there is no scene."""
    if (run / "scene.json").is_file():
        return run
    if (run / "scene" / "scene.json").is_file():
        return run / "scene"
    if not run.is_dir():
        raise InputError(f"{run}: no such file or folder; give the folder of a run or of a scene, or a mesh file")
    if not (run / "run.json").is_file() and not (run / "stages").is_dir():
        raise InputError(f"{run} is neither a run nor a scene; give the folder of one of them, or a mesh file")
    raise InputError(f"{run} has no finished scene; finish the run with: hir reconstruct … --resume")
