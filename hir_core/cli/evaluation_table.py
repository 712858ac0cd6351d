"""Tables of the results of `hir evaluate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.files.file_names import on_one_line

if TYPE_CHECKING:
    from rich.table import Table


def print_table(results: Sequence[Mapping[str, Any]]) -> None:
    """Prints one row per run: image metrics, then those by Stanford-ORB's rules and those against ground truth."""
    from rich.console import Console

    console = Console(highlight=False)
    console.print(table_of(results, IMAGE_COLUMNS))
    for key, columns in OTHER_TABLES.items():
        if any(key in r for r in results):
            console.print()
            console.print(table_of([r for r in results if key in r], columns))
    if any(r.get("exposures") for r in results):
        console.print("Each view is compared at the exposure and white balance that suit it best.", markup=False)
    for sentence in dict.fromkeys(r["lpips_missing"] for r in results if r["lpips_missing"]):
        console.print(sentence, markup=False)


Columns = tuple[tuple[str, str, int, bool], ...]
"""Heading, dotted key in the result, digits, whether larger is better."""

IMAGE_COLUMNS: Columns = (
    ("PSNR frame", "psnr.frame", 2, True),
    ("object", "psnr.object", 2, True),
    ("scaled frame", "psnr_scaled.frame", 2, True),
    ("object", "psnr_scaled.object", 2, True),
    ("SSIM", "ssim", 4, True),
    ("LPIPS", "lpips", 4, False),
    ("FLIP", "flip", 4, False),
    ("mask IoU", "iou", 4, True),
)

OTHER_TABLES: dict[str, Columns] = {
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
        ("visible Chamfer", "surface.seen.chamfer", 5, False),
        ("F at .005", "surface.seen.f_score.0|005", 4, True),
        ("normals, °", "surface.seen.normal_error_deg", 2, False),
    ),
    "albedo": (
        ("albedo PSNR", "albedo.psnr", 2, True),
        ("scaled", "albedo.psnr_scaled", 2, True),
        ("ORB", "albedo.stanford_orb_psnr", 2, True),
    ),
    "scan_texture": (
        ("the scan's own texture: scaled frame", "scan_texture.psnr_scaled.frame", 2, True),
        ("object", "scan_texture.psnr_scaled.object", 2, True),
    ),
    "light_error": (
        ("light, texels", "light_error.texels", 3, False),
        ("mirror sphere", "light_error.spheres.mirror", 3, False),
        ("silver", "light_error.spheres.silver", 3, False),
        ("diffuse", "light_error.spheres.diffuse", 3, False),
        ("colour, °", "light_error.angular_deg.diffuse", 2, False),
    ),
}


def table_of(results: Sequence[Mapping[str, Any]], columns: Columns) -> Table:
    """One row per run; with several runs the best value of each column is bold."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("run", "split"):
        table.add_column(heading, overflow="fold")
    for heading, *_ in columns:
        table.add_column(heading, justify="right", overflow="fold")
    best: dict[str, float | None] = {}
    for _, key, digits, more in columns:
        values = [round(v, digits) for r in results if (v := value_at(r, key)) is not None]
        best[key] = (max if more else min)(values) if len(values) > 1 else None
    for r in results:
        cells = []
        for _, key, digits, _ in columns:
            value = value_at(r, key)
            text = "–" if value is None else f"{value:.{digits}f}"
            cells.append(f"[bold]{text}[/bold]" if value is not None and round(value, digits) == best[key] else text)
        table.add_row(escape(on_one_line(Path(r["run"]).name)), escape(on_one_line(r["split"])), *cells)
    return table


def value_at(result: Mapping[str, Any], key: str) -> float | None:
    """The number at the dotted key `a.b.c`; `|` stands for a dot inside a name. None where there is none."""
    value: object = result
    for part in key.split("."):
        value = value.get(part.replace("|", ".")) if isinstance(value, dict) else None
    return value if isinstance(value, float | int) else None
