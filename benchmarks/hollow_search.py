"""Hollows that the search finds in the hull of captures with a true mesh, without the rest of a run.

    python -m benchmarks.hollow_search CAPTURE… --store FILE [--seeds 0 1 2]
    python -m benchmarks.hollow_search --table FILE

Captures come from `python -m benchmarks.materials make` and `python -m benchmarks.shape make`. Voxels of the hull that
are empty in truth and 1 voxel or more from its surface should be found, those inside it not. Each row is stored with
commit, date, machine and processor seconds.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stored_rows import add_rows, provenance, stored_rows, study_arguments
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_mesh
from hir_plugins.initializers.hollows.hollows import BLUR_VOXELS, SEARCH_VOXELS
from hir_plugins.initializers.hollows.photo_prediction import blurred_photographs
from hir_plugins.initializers.hollows.search import find_hollows
from hir_plugins.initializers.hollows.sunk_volume import sunk
from hir_plugins.initializers.hull.visual_hull import hull_volume
from hir_plugins.initializers.options import HollowsOptions, VisualHullOptions


def measured(path: Path, seed: int, plugins: PluginManager) -> dict[str, Any]:
    """What the search finds in a hull of `SEARCH_VOXELS` voxels, against the truth."""
    capture = decode_images(read_capture(path, "train", plugins))
    truth = true_mesh(path, capture)
    assert truth is not None, f"{path} has no reference.obj"
    coarse = replace(VisualHullOptions(), max_resolution=SEARCH_VOXELS, pixels_per_voxel=0.01)
    volume = hull_volume(capture, coarse)
    inside = np.argwhere(volume.values > 0)
    points = volume.origin + inside * volume.spacing
    outward = MeshQueries(*truth).signed_distance(points) / volume.spacing
    middle = np.eye(4)
    middle[:3, 3] = -points.mean(axis=0)
    photographs = blurred_photographs(capture.transformed(middle), BLUR_VOXELS * volume.spacing)
    volume = replace(volume, origin=volume.origin + middle[:3, 3])
    began = time.process_time()
    found = find_hollows(volume, photographs, seed, HollowsOptions.max_hollows)
    seconds = time.process_time() - began
    for hollow in found:
        volume = sunk(volume, volume, hollow.opening, hollow.depth, hollow.wall)
    removed = volume.values[tuple(inside.T)] <= 0
    empty, solid = outward > 1, outward < -1
    return {
        "capture": path.name,
        "half": path.parent.name,
        "seed": seed,
        "hollows": [{"depth": h.depth, "explained": h.explained, "from_far": h.explained_from_far} for h in found],
        "empty_voxels": int(empty.sum()),
        "found": round(float(removed[empty].mean()), 4) if empty.any() else None,
        "wrong": round(float(removed[solid].mean()), 4),
        "cpu_seconds": round(seconds, 1),
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a line for each capture; several seeds as the smallest to the largest value."""
    lines = [
        "| half | capture | seeds | hollows | explained | from far | empty voxels found | solid ones removed | CPU s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for half, name in sorted({(row["half"], row["capture"]) for row in rows}):
        own = [row for row in rows if row["capture"] == name]
        hollows = [hollow for row in own for hollow in row["hollows"]]
        cells = [str(len(own)), _range([float(len(row["hollows"])) for row in own], ".0f")]
        cells += [_range([hollow[key] for hollow in hollows], ".2f") for key in ("explained", "from_far")]
        found = [row["found"] for row in own if row["found"] is not None and row["empty_voxels"] >= 100]
        cells += [_range(found, ".1%"), _range([row["wrong"] for row in own], ".1%")]
        cells.append(_range([row["cpu_seconds"] for row in own], ".0f"))
        lines.append(f"| {half} | {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _range(values: Sequence[float], form: str) -> str:
    if not values:
        return "–"
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f"{low} to {high}"


def main() -> None:
    options = study_arguments(__doc__, Path("benchmarks/results/hollow_search.jsonl"), table)
    plugins = PluginManager.discover()
    known = {(row["capture"], row["seed"]) for row in stored_rows(options.store)}
    for path in options.captures:
        for seed in options.seeds:
            if (path.name, seed) not in known:
                add_rows(options.store, [measured(path, seed, plugins)])


if __name__ == "__main__":
    main()
