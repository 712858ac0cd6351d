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
    from hir_core.manager import PluginManager

    runs, capture = sort_paths(paths)
    options: dict[str, Any] = {}
    for assignment in assignments:
        assign(options, assignment)
    plugins = PluginManager.discover(plugin_files)
    from hir_core.evaluation import Question, evaluate_run
    from hir_core.progress import Progress
    from hir_core.report import refresh_page
    from hir_core.run_directory import open_run
    from hir_core.session import resolve_device

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
            refresh_page(directory)
    if as_json:
        click.echo(json.dumps(results[0] if len(results) == 1 else results, indent=1))
    else:
        print_table(results)


def sort_paths(paths: tuple[Path, ...]) -> tuple[list[Path], Path | None]:
    """Runs are folders with run.json; one other folder, last, is the capture."""
    runs = [path for path in paths if (path / "run.json").is_file()]
    others = [path for path in paths if path not in runs]
    if len(others) > 1 or (others and paths[-1] != others[0]) or not runs:
        wrong = others[0] if others else paths[0]
        raise InputError(f"{wrong} is not a run: it has no run.json (the capture, if one is named, comes last)")
    return runs, others[0] if others else None


def print_table(results: list[dict[str, Any]]) -> None:
    """One row for each run; then the conventions of Stanford-ORB, and what was compared with the truth."""
    from rich.console import Console

    console = Console(highlight=False)
    console.print(table_of(results, PICTURES))
    for key, columns in FURTHER.items():
        if any(key in r for r in results):
            console.print()
            console.print(table_of([r for r in results if key in r], columns))
    for sentence in dict.fromkeys(r["lpips_missing"] for r in results if r["lpips_missing"]):
        console.print(sentence, markup=False)


Columns = tuple[tuple[str, str, int, bool], ...]
"""Heading, dotted place in the result, digits, whether more is better."""

PICTURES: Columns = (
    ("PSNR frame", "psnr.frame", 2, True),
    ("object", "psnr.object", 2, True),
    ("scaled frame", "psnr_scaled.frame", 2, True),
    ("object", "psnr_scaled.object", 2, True),
    ("SSIM", "ssim", 4, True),
    ("LPIPS", "lpips", 4, False),
    ("FLIP", "flip", 4, False),
    ("mask IoU", "iou", 4, True),
)

FURTHER: dict[str, Columns] = {
    "stanford_orb": (
        ("Stanford-ORB: PSNR-H", "stanford_orb.psnr_h", 2, True),
        ("PSNR-L", "stanford_orb.psnr_l", 2, True),
        ("SSIM", "stanford_orb.ssim", 4, True),
        ("LPIPS", "stanford_orb.lpips", 4, False),
    ),
    "surface": (
        ("Chamfer, radii", "surface.chamfer", 5, False),
        ("accuracy", "surface.accuracy", 5, False),
        ("completeness", "surface.completeness", 5, False),
        ("seen Chamfer", "surface.seen.chamfer", 5, False),
        ("F at .005", "surface.seen.f_score.0|005", 4, True),
        ("normals, °", "surface.seen.normal_error_deg", 2, False),
    ),
    "albedo": (
        ("albedo PSNR", "albedo.psnr", 2, True),
        ("scaled", "albedo.psnr_scaled", 2, True),
        ("ORB", "albedo.stanford_orb_psnr", 2, True),
    ),
    "light_error": (
        ("light, texels", "light_error.texels", 3, False),
        ("mirror ball", "light_error.spheres.mirror", 3, False),
        ("silver", "light_error.spheres.silver", 3, False),
        ("diffuse", "light_error.spheres.diffuse", 3, False),
        ("colour, °", "light_error.angular_deg.diffuse", 2, False),
    ),
}


def table_of(results: list[dict[str, Any]], columns: Columns) -> Any:
    """Rows of runs, with the best of each column in bold where there are several."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("run", "split"):
        table.add_column(heading, overflow="fold")
    for heading, *_ in columns:
        table.add_column(heading, justify="right", overflow="fold")
    best = {}
    for _, place, digits, more in columns:
        values = [round(v, digits) for r in results if (v := value_at(r, place)) is not None]
        best[place] = (max if more else min)(values) if len(values) > 1 else None
    for r in results:
        cells = []
        for _, place, digits, _ in columns:
            value = value_at(r, place)
            text = "–" if value is None else f"{value:.{digits}f}"
            cells.append(f"[bold]{text}[/bold]" if value is not None and round(value, digits) == best[place] else text)
        table.add_row(Path(r["run"]).name, r["split"], *cells)
    return table


def value_at(result: dict[str, Any], place: str) -> float | None:
    """The number at `a.b.c` of nested tables; `|` stands for a point inside a name."""
    found: Any = result
    for part in place.split("."):
        found = found.get(part.replace("|", ".")) if isinstance(found, dict) else None
    return found if isinstance(found, float | int) else None
