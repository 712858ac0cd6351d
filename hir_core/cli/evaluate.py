"""`hir evaluate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from hir_core.cli.options import FOLDER, loudness_options, plugin_option
from hir_core.errors import InputError


@click.command("evaluate")
@click.argument("paths", nargs=-1, required=True, type=FOLDER, metavar="RUN... [CAPTURE]")
@click.option("--split", default="test", show_default=True, help="The views to compare with.")
@click.option("--relight", default="", metavar="FILE[*STRENGTH]", help="A lat-long light, in the capture's axes.")
@click.option("--views", type=click.IntRange(min=0), default=0, help="At most so many views, spread over the split.")
@click.option("--truth", is_flag=True, help="Compare mesh, albedo and light too, where the capture holds true ones.")
@click.option("--mesh", type=FOLDER, metavar="FILE", help="The true mesh, in the axes of the capture's files.")
@click.option(
    "--albedo", default="", metavar="SPLIT", help="A split of the capture that shows the true diffuse albedo."
)
@click.option("--renderer", default="", metavar="NAME", help="The reference renderer unless another is named.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Such as render_samples=256.")
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON; a list of it for several runs.")
@click.option("--download", is_flag=True, help="Fetch the weights that LPIPS needs where they are missing.")
@plugin_option
@loudness_options
def evaluate_command(
    paths: tuple[Path, ...],
    split: str,
    relight: str,
    views: int,
    truth: bool,
    mesh: Path | None,
    albedo: str,
    renderer: str,
    assignments: tuple[str, ...],
    device: str,
    as_json: bool,
    download: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Compares runs with photographs they never saw: PSNR, SSIM, LPIPS, FLIP; relit where the split has another light.

    A RUN is a folder with run.json. CAPTURE, given last, defaults to each run's own.
    """
    from hir_core.cli.progress_bar import ProgressBar
    from hir_core.config import assign
    from hir_core.plugins.manager import PluginManager

    runs, capture = sort_paths(paths)
    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    plugins = PluginManager.discover(plugin_files)
    from hir_core.evaluation import Question, evaluate_run
    from hir_core.plugins.progress import Progress
    from hir_core.report import refresh_page
    from hir_core.run.run_directory import open_run
    from hir_core.run.session import resolve_device

    question = Question(
        split, capture, relight, renderer, options, resolve_device(device), download, mesh, albedo, views, truth
    )
    results = []
    with ProgressBar(quiet=quiet or as_json) as bar:
        for run in runs:
            import time

            started = time.perf_counter()
            directory = open_run(run)

            def told(done: int, count: int, text: str, name: str = run.name, since: float = started) -> None:
                bar.update(Progress(name, done, count, time.perf_counter() - since, message=text))

            results.append(evaluate_run(directory, question, plugins, told))
            refresh_page(directory, plugins)
    if as_json:
        click.echo(json.dumps(results[0] if len(results) == 1 else results, indent=1))
    else:
        from hir_core.cli.evaluation_table import print_table

        print_table(results)


def sort_paths(paths: tuple[Path, ...]) -> tuple[list[Path], Path | None]:
    """Runs are folders with run.json; one other folder, last, is the capture."""
    runs = [path for path in paths if (path / "run.json").is_file()]
    others = [path for path in paths if path not in runs]
    if len(others) > 1 or (others and paths[-1] != others[0]) or not runs:
        wrong = others[0] if others else paths[0]
        raise InputError(f"{wrong} is not a run: it has no run.json (the capture, if one is named, comes last)")
    return runs, others[0] if others else None
