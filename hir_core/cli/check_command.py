"""`hir check`: finds problems of a capture before a fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hir_core.errors import HirError, InputError
from hir_core.files.file_names import on_one_line
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options

if TYPE_CHECKING:
    from hir_core.capture import Array, Capture, Pixels
    from hir_core.intake.check_result import CaptureCheck

ROWS = 12
"""Maximum number of photographs in the table without -v."""
REFINES = "refines_cameras"
"""The trait of initializers that mend given cameras."""


@click.command("check")
@click.argument("capture", type=FOLDER)
@click.option("--split", default="train", show_default=True, help="The split to check.")
@click.option(
    "--reader", default="auto", show_default=True, metavar="NAME", help="The capture reader; auto detects it."
)
@click.option(
    "--sheet", type=FOLDER, metavar="FILE.png", help="Write a contact sheet of all photographs with their masks."
)
@click.option(
    "--mesh",
    type=FOLDER,
    metavar="FILE",
    help="A mesh of the object, in the capture's axes: detects a light that moves with the camera.",
)
@click.option(
    "--photographs",
    type=click.IntRange(0),
    default=0,
    metavar="N",
    help="Check N photographs, evenly spaced, instead of all of them.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@plugin_option
@verbosity_options
def check_command(
    capture: Path,
    split: str,
    reader: str,
    sheet: Path | None,
    mesh: Path | None,
    photographs: int,
    as_json: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Finds problems of CAPTURE before a fit: blur, clipping, masks that contradict the cameras.

    Uses the mask sources of `hir reconstruct` that need no cameras. -v lists every photograph.
    """
    from hir_core.files.json_documents import jsonable
    from hir_core.intake.capture_advice import advice_on_cameras, cameras_are_inexact
    from hir_core.intake.capture_check import check_capture
    from hir_core.intake.contact_sheet import contact_sheet
    from hir_core.intake.mask_sources import with_automatic_masks
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.view_selection import evenly_spaced_indices
    from hir_core.run.python_warnings import forward_user_warnings

    if sheet is not None and sheet.suffix.lower() != ".png":
        raise InputError(f"--sheet {sheet}: the contact sheet is a PNG; give a name that ends in .png")
    plugins = PluginManager.discover(plugin_files)
    said: list[str] = []
    with forward_user_warnings(said.append):
        whole = read_capture(capture, split, plugins, reader)
    if photographs:
        chosen = evenly_spaced_indices(len(whole.views), photographs)
        whole = replace(whole, views=tuple(whole.views[i] for i in chosen))
    found = with_automatic_masks(whole if quiet else with_progress(whole), plugins)
    if not found.views:
        raise InputError(f"{capture} has no photographs in the split {split}; give the folder of a capture")
    check = check_capture(found, None if mesh is None else surface_of(mesh, found))
    if cameras_are_inexact(check):
        refining = [r.component.name for r in plugins.components("initializer") if REFINES in r.component.traits]
        said.append(advice_on_cameras(check, plugins.suggest_initializers(found), refining))
    check = replace(check, advice=(*said, *check.advice))
    if sheet is not None:
        from hir_exporters.textures.image_files import write_png

        write_png(sheet, contact_sheet(found))
    if as_json:
        facts = {"path": str(capture), "reader": found.reader, "split": split}
        click.echo(json.dumps(jsonable(facts | asdict(check)), indent=1))
        return
    if not quiet:
        print_views(check, verbose)
    click.echo(summary(found, check))
    for sentence in check.advice:
        click.echo(f"→ {on_one_line(sentence)}")
    if not check.advice:
        click.echo("no problems found")
    if sheet is not None and not quiet:
        click.echo(str(sheet))


def with_progress(capture: Capture) -> Capture:
    """The capture with views that say on stderr, every `LINE_SECONDS`, how many photographs have been decoded."""
    from hir_core.plugins.progress import Throttle
    from hir_core.terminal.progress_bar import LINE_SECONDS

    throttle = Throttle(LINE_SECONDS)
    times_read = [0] * len(capture.views)

    def counted(index: int, read: Callable[[], Pixels]) -> Callable[[], Pixels]:
        def read_and_report() -> Pixels:
            pixels = read()
            times_read[index] += 1
            if throttle.ready:
                throttle.restart()
                reading = times_read[index]
                number = sum(times >= reading for times in times_read)
                click.echo(
                    f"decoded {number} of {len(capture.views)} photographs (reading {reading}, each is read at least "
                    "twice); --photographs N checks fewer, Ctrl-C stops",
                    err=True,
                )
            return pixels

        return read_and_report

    views = (replace(view, read=counted(i, view.read)) for i, view in enumerate(capture.views))
    return replace(capture, views=tuple(views))


def surface_of(mesh: Path, capture: Capture) -> tuple[Array, Array]:
    """Vertices and unit normals (N, 3) of a mesh file in the capture's axes, moved to the world of its cameras."""
    import numpy as np
    from hir_exporters.reading.mesh_references import load_mesh_scene

    if not mesh.is_file():
        raise InputError(f"--mesh {mesh}: no such file")
    try:
        loaded = load_mesh_scene(mesh).to_mesh()
        positions, normals = np.asarray(loaded.vertices, float), np.asarray(loaded.vertex_normals, float)
    except HirError:
        raise
    except Exception as error:  # parsers of trimesh raise many types
        raise InputError(f"{mesh} cannot be read as a mesh ({type(error).__name__}: {error})") from error
    if not len(loaded.faces) or not np.isfinite(positions).all():
        raise InputError(f"{mesh} has no triangles, or vertices that are not finite")
    world = capture.world_from_source
    turned = normals @ world[:3, :3].T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return positions @ world[:3, :3].T + world[:3, 3], turned / np.maximum(length, 1e-300)


def summary(capture: Capture, check: CaptureCheck) -> str:
    """One line: counts, sizes, agreement of masks and cameras."""
    sizes = sorted({(v.width, v.height) for v in check.views})
    masks = sum(v.mask_share is not None for v in check.views)
    size = f"{sizes[0][0]}×{sizes[0][1]}" + (f" to {sizes[-1][0]}×{sizes[-1][1]}" if len(sizes) > 1 else "")
    parts = [f"{len(check.views)} photographs of {size} ({capture.reader})"]
    parts += [f"{check.with_camera} cameras", f"{masks} masks"]
    if check.takes:
        listed = ", ".join(f"{on_one_line(take.name)} {take.photographs}" for take in check.takes)
        parts.append(f"{len(check.takes)} takes ({listed})")
    scores = sorted(v.agreement for v in check.views if v.agreement is not None)
    if scores:
        parts.append(f"masks and cameras agree to {scores[len(scores) // 2]:.2f} (worst {scores[0]:.2f})")
    if check.directions_covered is not None:
        parts.append(f"{check.directions_covered:.0%} of all directions covered")
    if check.headlight is not None:
        parts.append(f"light follows the camera: {check.headlight:.2f}")
    return ", ".join(parts)


def print_views(check: CaptureCheck, every: bool) -> None:
    """A table of the photographs: all with `every`, else those of the lowest agreement and sharpness."""
    from rich.console import Console
    from rich.table import Table

    views = list(check.views)
    if not every and len(views) > ROWS:
        worst = sorted(views, key=lambda v: (v.agreement if v.agreement is not None else 1.0, v.sharpness))[:ROWS]
        views = [view for view in views if view in worst]
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("photograph", "size", "agreement", "sharpness", "clipped", "brightness", "mask"):
        table.add_column(heading, justify="left" if heading == "photograph" else "right")
    for v in views:
        table.add_row(
            on_one_line(v.name).replace("[", "\\["),
            f"{v.width}×{v.height}",
            "–" if v.agreement is None else f"{v.agreement:.2f}",
            f"{v.sharpness:.2f}",
            f"{v.saturated:.1%}",
            f"{v.brightness:.3f}",
            "–" if v.mask_share is None else f"{v.mask_share:.1%}",
        )
    console = Console(highlight=False)
    console.print(table)
    if len(views) < len(check.views):
        console.print(f"the {len(views)} worst of {len(check.views)}; -v lists all")
