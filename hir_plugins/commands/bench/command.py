"""`hir bench`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import click

from hir_core.errors import ConfigError
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages

if TYPE_CHECKING:
    from hir_plugins.commands.bench.bench_options import BenchOptions
    from hir_plugins.commands.bench.materials_options import MaterialsOptions, MeshSource

SUITE_NAMES: Final = (
    "geometry",
    "initializers",
    "shape",
    "atlas",
    "shading",
    "reflectance",
    "regularizers",
    "export",
    "materials",
    "end-to-end",
)


@click.command("bench")
@click.argument("suites", nargs=-1, metavar=f"[{'|'.join(SUITE_NAMES)}]...")
@click.option(
    "--capture",
    "captures",
    multiple=True,
    type=FOLDER,
    metavar="DIR",
    help="Capture for the suites that fit; results are compared with its reference.obj and test split. Repeatable.",
)
@click.option("-o", "--output", type=FOLDER, metavar="DIR", help="Write SUITE.json, SUITE.md and SUITE.svg to DIR.")
@click.option("--quick", is_flag=True, help="Measure only the smallest sizes.")
@click.option(
    "--repeats", type=click.IntRange(min=1), default=5, show_default=True, help="Repetitions of each measurement."
)
@click.option(
    "--limit",
    type=click.FloatRange(min=0.1),
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="Omit sizes that are expected to take longer; the table notes them.",
)
@click.option("--peers/--no-peers", default=True, help="Measure other programs too, if they are installed.")
@click.option(
    "--workspace",
    type=FOLDER,
    metavar="DIR",
    help="Keep the runs of materials and end-to-end, and the rows of shape, in DIR; an interrupted suite resumes them.",
)
@click.option(
    "--materials",
    "materials_folder",
    type=FOLDER,
    metavar="DIR",
    help="Folder of `python -m benchmarks.materials make`, for the suite materials.",
)
@click.option(
    "--half",
    type=click.Choice(("tuning", "validation", "both")),
    help="Half of the made captures; `validation` is for reports only.  [default: tuning]",
)
@click.option("--only", multiple=True, metavar="CAPTURE", help="Name or number of a made capture. Repeatable.")
@click.option("--seeds", metavar="N,N…", help="Seeds of the runs on made captures.  [default: 0]")
@click.option(
    "--mesh",
    type=click.Choice(("reconstructed", "truth")),
    help="Mesh of the runs on made captures: their own, or the true one, held fixed.  [default: reconstructed]",
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="Setting of all runs on made captures, in place of its default. Repeatable.",
)
@click.option("--regret", is_flag=True, help="Also fit each kind of material and light by force, and compare.")
@click.option(
    "--compare",
    nargs=2,
    type=FOLDER,
    metavar="OLD.json NEW.json",
    help="Measure nothing; print the ratios of two results.",
)
@plugin_option
@verbosity_options
def bench_command(
    suites: tuple[str, ...],
    captures: tuple[Path, ...],
    output: Path | None,
    quick: bool,
    repeats: int,
    limit: float,
    peers: bool,
    workspace: Path | None,
    compare: tuple[Path, Path] | None,
    materials_folder: Path | None,
    half: Literal["tuning", "validation", "both"] | None,
    only: tuple[str, ...],
    seeds: str | None,
    mesh: MeshSource | None,
    assignments: tuple[str, ...],
    regret: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Measures time, memory and error of every installed component at growing sizes.

    Errors are relative to a slow reference. Without a suite's name, all suites run; initializers, shape, reflectance
    and end-to-end need --capture, materials needs --materials.
    """
    if compare:
        from hir_plugins.commands.bench.results.bench_result import Result
        from hir_plugins.commands.bench.results.comparison import comparison_table

        click.echo(comparison_table(*(Result.read(path) for path in compare)))
        return
    require_reconstruction_packages("hir bench")
    import tempfile

    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.bench.bench_options import BenchOptions
    from hir_plugins.commands.bench.suites.suite_registry import MADE_CAPTURES, SUITES, SUITES_WITH_CAPTURES

    for name in suites:
        if name not in SUITES:
            raise ConfigError(f"there is no suite {name!r}; the suites are: {', '.join(SUITES)}")
        if name in SUITES_WITH_CAPTURES and not captures:
            raise ConfigError(f"hir bench {name} needs photographs; name a capture with --capture DIR")
    needs = {MADE_CAPTURES: materials_folder, **dict.fromkeys(SUITES_WITH_CAPTURES, captures)}
    selected = suites or tuple(name for name in SUITES if needs.get(name, True))
    materials = _materials_options(
        MADE_CAPTURES in selected, materials_folder, half, only, seeds, mesh, regret, assignments
    )
    plugins = PluginManager.discover(plugin_files)
    with tempfile.TemporaryDirectory() as temporary:
        folder = workspace or Path(temporary)
        options = BenchOptions(plugins, captures, quick, repeats, peers, limit, folder, materials)
        for name in selected:
            _run_suite(name, options, output, quiet)


def _materials_options(
    is_selected: bool,
    folder: Path | None,
    half: Literal["tuning", "validation", "both"] | None,
    only: tuple[str, ...],
    seeds: str | None,
    mesh: MeshSource | None,
    regret: bool,
    assignments: tuple[str, ...],
) -> MaterialsOptions | None:
    """The options of the suite materials; `ConfigError` where it lacks its folder, or where only it would use one."""
    from hir_plugins.commands.bench.materials_options import HALVES, MaterialsOptions, parse_seeds

    given = {
        "--materials": folder,
        "--half": half,
        "--only": only,
        "--seeds": seeds,
        "--mesh": mesh,
        "--regret": regret,
        "--set": assignments,
    }
    if not is_selected:
        unused = [name for name, value in given.items() if value]
        if unused:
            raise ConfigError(f"{', '.join(unused)}: only the suite materials has this option; add its name")
        return None
    if folder is None:
        raise ConfigError("hir bench materials needs made captures; name their folder with --materials DIR")
    halves = HALVES if half == "both" else (half or "tuning",)
    return MaterialsOptions(
        folder, halves, only, parse_seeds(seeds or "0"), mesh or "reconstructed", regret, assignments
    )


def _run_suite(suite: str, options: BenchOptions, output: Path | None, quiet: bool) -> None:
    """Runs one suite. The result is written after each row, so that an interrupted suite keeps its measurements."""
    from hir_exporters.files.atomic import write_text_atomic

    from hir_plugins.commands.bench.results.bench_result import Result
    from hir_plugins.commands.bench.results.markdown_tables import method_label, result_markdown, seconds_text
    from hir_plugins.commands.bench.results.plot import plot_svg
    from hir_plugins.commands.bench.suites.suite_registry import MADE_CAPTURES, suite_rows

    settings: dict[str, Any] = {
        "quick": options.quick,
        "repeats": options.repeats,
        "captures": [path.name for path in options.captures],
    }
    if suite == MADE_CAPTURES and options.materials is not None:
        settings["materials"] = asdict(options.materials) | {"folder": options.materials.folder.name}
    result = Result(suite, (), settings=settings)
    for row in suite_rows(suite, options):
        result = Result(suite, (*result.rows, row), settings=settings)
        if not quiet:
            case = " ".join(str(value) for value in row.case.values())
            errors = ", ".join(f"{name} {value:.3g}" for name, value in row.errors.items())
            line = f"{suite}: {case}: {method_label(row)}: {seconds_text(row.timing)} s {errors} {row.note}"
            click.echo(line.rstrip(), err=True)
        if output is not None:
            result.write(output / f"{suite}.json")
    if not result.rows:
        click.echo(
            f"{suite}: nothing was measured; the suite needs captures with known cameras and a reference.obj", err=True
        )
        return
    if output is not None:
        write_text_atomic(output / f"{suite}.md", result_markdown(result))
        write_text_atomic(output / f"{suite}.svg", plot_svg(result))
    click.echo(result_markdown(result))
