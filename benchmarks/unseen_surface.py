"""Hulls of photographs from above only, with the cone below the object and with a membrane in its place.

    python -m benchmarks.unseen_surface CAPTURE… --store FILE [--seeds 0]
    python -m benchmarks.unseen_surface --table FILE

Captures come from `python -m benchmarks.materials make` and `python -m benchmarks.shape make`, whose cameras see an
object from below, too. Photographs below an elevation are left out, and the hull is compared with the surface that all
of them see. Each row is stored with commit, date, machine and processor seconds.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stored_rows import add_rows, provenance, stored_rows, study_arguments
from hir_core.capture import Camera
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_mesh

ELEVATIONS = (-90, 3, 10, 20)
"""Of the lowest photographs, in degrees above the horizon; −90 is all of them."""
SURFACES = ("hull", "membrane")


def elevation(camera: Camera) -> float:
    """Of a camera around the origin in the world, whose +Y is up; in degrees."""
    center = np.asarray(camera.center, np.float64)
    return float(np.degrees(np.arcsin(center[1] / np.linalg.norm(center))))


def measured(path: Path, seed: int, plugins: PluginManager) -> list[dict[str, Any]]:
    """A row for each elevation and kind of surface, against the truth."""
    capture = decode_images(read_capture(path, "train", plugins))
    truth = true_mesh(path, capture)
    assert truth is not None, f"{path} has no reference.obj"
    rows = []
    for lowest in ELEVATIONS:
        views = tuple(v for v in capture.views if v.camera is not None and elevation(v.camera) >= lowest)
        for surface in SURFACES:
            options = {"unseen_surface": surface, "vertex_colors": False}
            hull = plugins.create("initializer", "visual_hull", options, seed)
            began = time.process_time()
            _, scene = hull.initialize(replace(capture, views=views), None, path)
            seconds = time.process_time() - began
            assert scene is not None
            mesh = scene.mesh.positions.numpy().astype(np.float64), scene.mesh.faces.numpy()
            figures = compare_surfaces(mesh, truth, capture.cameras)
            rows.append(
                {
                    "capture": path.name,
                    "half": path.parent.name,
                    "seed": seed,
                    "lowest_elevation": lowest,
                    "photographs": len(views),
                    "surface": surface,
                    "chamfer": round(figures.chamfer, 5),
                    "normal_error_deg": round(figures.normal_error_deg, 2),
                    "self_intersecting": inspect_mesh(*mesh).self_intersecting,
                    "report": dict(hull.report()),
                    "cpu_seconds": round(seconds, 2),
                    **provenance(),
                }
            )
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a line for each capture and elevation."""
    lines = [
        "| half | capture | photographs above | number | Chamfer: hull | membrane | normals: hull | membrane |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for half, name, lowest in sorted({(row["half"], row["capture"], row["lowest_elevation"]) for row in rows}):
        own = {row["surface"]: row for row in rows if (row["capture"], row["lowest_elevation"]) == (name, lowest)}
        hull, membrane = own["hull"], own["membrane"]
        bound = "all" if lowest <= -90 else f"{lowest}°"
        cells = [half, name, bound, str(hull["photographs"]), f"{hull['chamfer']:.4f}", f"{membrane['chamfer']:.4f}"]
        cells += [f"{each['normal_error_deg']:.1f}°" for each in (hull, membrane)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    options = study_arguments(__doc__, Path("benchmarks/results/unseen_surface.jsonl"), table)
    plugins = PluginManager.discover()
    known = {(row["capture"], row["seed"]) for row in stored_rows(options.store)}
    for path in options.captures:
        for seed in options.seeds:
            if (path.name, seed) not in known:
                add_rows(options.store, measured(path, seed, plugins))


if __name__ == "__main__":
    main()
