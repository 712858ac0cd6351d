"""`hir evaluate`: measures runs against photographs and ground truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from hir_core.errors import InputError
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.plugin_problems import echo_problems
from hir_core.terminal.required_packages import require_reconstruction_packages


@click.command("evaluate")
@click.argument("paths", nargs=-1, required=True, type=FOLDER, metavar="RUN... [CAPTURE]")
@click.option("--split", default="test", show_default=True, help="The split to compare with.")
@click.option(
    "--relight",
    default="",
    metavar="FILE[*STRENGTH]",
    help="Render under this lat-long light, in the axes of the capture's light; without one +Y is up.",
)
@click.option(
    "--views", type=click.IntRange(min=0), default=0, help="Maximum number of views, evenly spaced; 0 for all."
)
@click.option("--truth", is_flag=True, help="Also compare mesh, albedo and light where the capture has ground truth.")
@click.option("--mesh", type=FOLDER, metavar="FILE", help="The true mesh, in the axes of the capture's files.")
@click.option("--albedo", default="", metavar="SPLIT", help="A split whose images are the true diffuse albedo.")
@click.option(
    "--renderer", default="", metavar="NAME", help="A reflectance renderer in place of the reference renderer."
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="An option of the renderer, such as render_samples=256; repeatable.",
)
@click.option(
    "--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True, help="Where to render."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON; a list for several runs.")
@click.option("--download", is_flag=True, help="Download the weights of LPIPS if they are missing.")
@plugin_option
@verbosity_options
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
    """Compares runs with photographs that the fit did not use: PSNR, SSIM, LPIPS, FLIP.

    A RUN is a folder with run.json. CAPTURE, the last argument, defaults to the capture of each run. Where the split
    has another light than the train split, the run is rendered under that light.
    """
    require_reconstruction_packages("hir evaluate")
    from hir_core.config import assign
    from hir_core.plugins.manager import PluginManager
    from hir_core.terminal.progress_bar import ProgressBar

    runs, capture = sort_paths(paths)
    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    plugins = PluginManager.discover(plugin_files)
    from hir_core.evaluation import EvaluationRequest, evaluate_run
    from hir_core.plugins.progress import Progress
    from hir_core.report import refresh_page
    from hir_core.run.device import resolve_device
    from hir_core.run.run_directory import open_run

    request = EvaluationRequest(
        split, capture, relight, renderer, options, resolve_device(device), download, mesh, albedo, views, truth
    )
    results = []
    with ProgressBar(quiet=quiet or as_json) as bar:
        for run in runs:
            import time

            started = time.perf_counter()
            directory = open_run(run)

            def show_progress(done: int, count: int, text: str, name: str = run.name, since: float = started) -> None:
                bar.update(Progress(name, done, count, time.perf_counter() - since, message=text))

            results.append(evaluate_run(directory, request, plugins, show_progress))
            known = len(plugins.problems)
            refresh_page(directory, plugins)
            echo_problems(plugins.problems[known:])
    if as_json:
        click.echo(json.dumps(results[0] if len(results) == 1 else results, indent=1))
    else:
        from hir_core.cli.evaluation_table import print_table

        print_table(results)


def sort_paths(paths: tuple[Path, ...]) -> tuple[list[Path], Path | None]:
    """Splits the arguments: folders with run.json are runs; one other folder, the last argument, is the capture."""
    runs = [path for path in paths if (path / "run.json").is_file()]
    others = [path for path in paths if path not in runs]
    if len(others) > 1 or (others and paths[-1] != others[0]) or not runs:
        wrong = others[0] if others else paths[0]
        raise InputError(f"{wrong} is not a run: it has no run.json (a capture must be the last argument)")
    return runs, others[0] if others else None
