"""`hir bench`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option
from hir_core.errors import ConfigError

if TYPE_CHECKING:
    from hir_plugins.commands.bench.bench_plan import Plan

NAMES = ("geometry", "initializers", "reflectance", "regularizers", "export", "end-to-end")


@click.command("bench")
@click.argument("suites", nargs=-1, metavar=f"[{'|'.join(NAMES)}]...")
@click.option(
    "--capture",
    "captures",
    multiple=True,
    type=FOLDER,
    metavar="DIR",
    help="For suites that fit; judged by its reference.obj and test split. As often as needed.",
)
@click.option("-o", "--output", type=FOLDER, metavar="DIR", help="Write SUITE.json, SUITE.md and SUITE.svg there.")
@click.option("--quick", is_flag=True, help="The smallest sizes alone.")
@click.option("--repeats", type=click.IntRange(min=1), default=5, show_default=True, help="Of each measurement.")
@click.option(
    "--limit",
    type=click.FloatRange(min=0.1),
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="Leave out sizes that would take longer, and say so.",
)
@click.option("--peers/--no-peers", default=True, help="Measure other programs too, where they are installed.")
@click.option(
    "--workspace", type=FOLDER, metavar="DIR", help="Keep the runs of end-to-end there; they go on if stopped."
)
@click.option(
    "--compare", nargs=2, type=FOLDER, metavar="OLD.json NEW.json", help="Print ratios of two results, and stop."
)
@plugin_option
@loudness_options
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
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Measures every installed component at growing sizes: seconds, memory, and error against a slow reference.

    Without a suite's name all run that can: initializers and end-to-end need --capture.
    """
    if compare:
        from hir_plugins.commands.bench.results.bench_result import Result
        from hir_plugins.commands.bench.results.comparison import markdown as ratios

        click.echo(ratios(*(Result.read(path) for path in compare)))
        return
    import tempfile

    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.bench.bench_plan import Plan
    from hir_plugins.commands.bench.suites.suite_registry import NEEDS_CAPTURES, SUITES

    for name in suites:
        if name not in SUITES:
            raise ConfigError(f"there is no suite {name!r}; there are: {', '.join(SUITES)}")
        if name in NEEDS_CAPTURES and not captures:
            raise ConfigError(f"hir bench {name} measures on photographs; name a capture with --capture DIR")
    chosen = suites or tuple(name for name in SUITES if captures or name not in NEEDS_CAPTURES)
    plugins = PluginManager.discover(plugin_files)
    with tempfile.TemporaryDirectory() as scratch:
        plan = Plan(plugins, captures, quick, repeats, peers, limit, workspace or Path(scratch))
        for name in chosen:
            _run(name, plan, output, quiet)


def _run(suite: str, plan: Plan, output: Path | None, quiet: bool) -> None:
    """One suite; what is measured is written row by row, so that a benchmark that is stopped was not for nothing."""
    from hir_exporters.files.atomic import write_text_atomic

    from hir_plugins.commands.bench.results.bench_result import Result
    from hir_plugins.commands.bench.results.markdown_tables import labelled, markdown, seconds
    from hir_plugins.commands.bench.results.plot import plot_svg
    from hir_plugins.commands.bench.suites.suite_registry import rows_of

    settings = {"quick": plan.quick, "repeats": plan.repeats, "captures": [path.name for path in plan.captures]}
    result = Result(suite, (), settings=settings)
    for row in rows_of(suite, plan):
        result = Result(suite, (*result.rows, row), settings=settings)
        if not quiet:
            case = " ".join(str(value) for value in row.case.values())
            found = ", ".join(f"{name} {value:.3g}" for name, value in row.errors.items())
            line = f"{suite}: {case}: {labelled(row)}: {seconds(row.timing)} s {found} {row.note}"
            click.echo(line.rstrip(), err=True)
        if output is not None:
            result.write(output / f"{suite}.json")
    if not result.rows:
        click.echo(
            f"{suite}: nothing was measured; are there captures with known cameras and a reference.obj?", err=True
        )
        return
    if output is not None:
        write_text_atomic(output / f"{suite}.md", markdown(result))
        write_text_atomic(output / f"{suite}.svg", plot_svg(result))
    click.echo(markdown(result))
