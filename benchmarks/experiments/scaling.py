"""Tables of the scaling study: seconds and memory by number and size of photographs, and how each stage grows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from benchmarks.experiments.cells import Cell
from benchmarks.experiments.studies import SCALING

STAGES = ("initializer", "geometry", "atlas", "reflectance", "bake", "export")
WORTH_SECONDS = 10.0
"""Shorter stages are dominated by start-up time and by noise of the machine."""


def scaling_table() -> list[str]:
    """Seconds and memory by number and size of photographs."""
    sizes = list(dict.fromkeys(cell.side for _, cell in SCALING.rows))
    lines = ["| photographs | " + " | ".join(f"{side}²" for side in sizes) + " |", "|---|" + "---|" * len(sizes)]
    for views in dict.fromkeys(cell.views for _, cell in SCALING.rows):
        found = []
        for side in sizes:
            cell = next(c for _, c in SCALING.rows if c.views == views and c.side == side)
            found.append(scaling_cell(cell))
        lines.append(f"| {views} | " + " | ".join(found) + " |")
    return lines


def growth_table() -> list[str]:
    """Seconds of each stage in the smallest and the largest run, and the steepest growth of each stage."""
    found = {(cell.views, cell.side): cell.stored() for _, cell in SCALING.rows}
    done = {size: result["stages"] for size, result in found.items() if result is not None}
    if len(done) < len(found):
        return []
    small, large = min(done), max(done)
    pixels = large[0] * large[1] ** 2 / (small[0] * small[1] ** 2)
    lines = [
        "",
        "Where the time goes, in processor seconds, and the steepest growth between two neighbours of the table above,",
        f"as a power of their pixels (1: linear), where the larger takes {WORTH_SECONDS:.0f} s or more. The largest",
        f"run has {pixels:.0f} times the pixels of the smallest.",
        "",
        f"| stage | {small[0]} × {small[1]}² | {large[0]} × {large[1]}² | times | steepest |",
        "|---|---|---|---|---|",
    ]
    for stage in STAGES:
        seconds = {size: stages[stage]["processor_seconds"] for size, stages in done.items()}
        ratio = seconds[large] / max(seconds[small], 1e-3)
        steepest = max(powers(seconds), default=None)
        power = "–" if steepest is None else f"{steepest:.2f}"
        lines.append(f"| {stage} | {seconds[small]:.1f} | {seconds[large]:.1f} | {ratio:.1f} | {power} |")
    return lines


def powers(seconds: Mapping[tuple[int, int], float]) -> list[float]:
    """Growth between neighbours by views or by side, as powers of the ratio of their pixels."""
    by_views, by_side = (sorted({size[i] for size in seconds}) for i in (0, 1))
    pairs = [((a, side), (b, side)) for a, b in pairwise(by_views) for side in by_side]
    pairs += [((views, a), (views, b)) for a, b in pairwise(by_side) for views in by_views]
    return [
        math.log(seconds[b] / seconds[a]) / math.log(b[0] * b[1] ** 2 / (a[0] * a[1] ** 2))
        for a, b in pairs
        if seconds[b] >= WORTH_SECONDS and seconds[a] > 0
    ]


def scaling_cell(cell: Cell) -> str:
    """Processor seconds of all and of the two long stages, and peak memory."""
    result = cell.stored()
    if result is None:
        return "–"
    stages = result["stages"]
    parts = " + ".join(f"{stages[n]['processor_seconds']:.0f}" for n in ("geometry", "reflectance"))
    return f"{result['processor_seconds']:.0f} s ({parts}), {result['peak_memory_bytes'] / 2**30:.1f} GiB"
