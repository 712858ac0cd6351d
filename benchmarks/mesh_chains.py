"""Meshes of the default chain and of those before it, against true meshes.

    python -m benchmarks.mesh_chains CAPTURE… --store benchmarks/results/mesh_chains.jsonl
    python -m benchmarks.mesh_chains --table benchmarks/results/mesh_chains.jsonl

`former` is the visual hull, fitted at two levels with final edges of four pixels. `stereo` is hull and stereo, then the
geometry stage. `default` is what `hir reconstruct` does: hull, hollows and stereo, then the geometry stage. Captures
come from `python -m benchmarks.shape make`. Each row is stored with commit, date, machine and processor seconds; a row
that is stored already is not measured again.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.stored_rows import add_rows, provenance, stored_rows, study_arguments
from hir_core.capture import Capture
from hir_core.config import load_config
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_mesh

CHAINS = {
    "former": ("visual_hull",),
    "stereo": ("visual_hull", "stereo"),
    "default": ("visual_hull", "hollows", "stereo"),
}
FORMER_EDGE_PIXELS, FORMER_LEVELS = 4.0, 2


def measured(path: Path, method: str, seed: int, plugins: PluginManager) -> dict[str, Any]:
    """Errors of a method's mesh against the true one."""
    capture = decode_images(read_capture(path, "train", plugins))
    truth = true_mesh(path, capture)
    assert truth is not None, f"{path} has no reference.obj"
    began = time.process_time()
    mesh, reports = _fitted(capture, method, seed, plugins)
    seconds = time.process_time() - began
    arrays = (mesh.mesh.positions.detach().numpy().astype(np.float64), mesh.mesh.faces.numpy())
    figures, state, true_state = (
        compare_surfaces(arrays, truth, capture.cameras),
        inspect_mesh(*arrays),
        inspect_mesh(*truth),
    )
    return {
        "capture": path.name,
        "half": path.parent.name,
        "method": method,
        "seed": seed,
        "chamfer": round(figures.chamfer, 6),
        "completeness": round(figures.completeness, 6),
        "normals_deg": round(figures.normal_error_deg, 3),
        "genus": state.genus,
        "true_genus": true_state.genus,
        "self_intersecting": state.self_intersecting,
        "triangles": len(arrays[1]),
        "cpu_seconds": round(seconds, 1),
        "reports": reports,
        **provenance(),
    }


def _fitted(capture: Capture, method: str, seed: int, plugins: PluginManager) -> tuple[Scene, dict[str, Any]]:
    scene: Scene | None = None
    reports: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        workspace = Path(folder)
        (workspace / "checkpoints").mkdir()
        for name in CHAINS[method]:
            initializer = plugins.create("initializer", name, {"vertex_colors": False}, seed)
            _, scene = initializer.initialize(capture, scene, workspace)
            reports[name] = dict(initializer.report())
        assert scene is not None
        settings = load_config(plugins).geometry
        context = StageContext(plugins, workspace, seed=seed)
        if method == "former":
            with patch("hir_core.stages.geometry.silhouettes.level_plan.FINAL_EDGE_PIXELS", FORMER_EDGE_PIXELS):
                fitted, _ = fit_geometry(scene, capture, replace(settings, levels=FORMER_LEVELS), context)
        else:
            fitted, _ = fit_geometry(scene, capture, settings, context)
    return fitted.scene, {name: reports[name] for name in ("hollows", "stereo") if name in reports}


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table of stored rows, one line a capture; several seeds as mean ± standard deviation."""
    lines = [
        "| half | capture | Chamfer, former → stereo → default | normals, ° | genus (true) | CPU s |",
        "|---|---|---|---|---|---|",
    ]
    for half, name in sorted({(row["half"], row["capture"]) for row in rows}):
        both = [[r for r in rows if r["capture"] == name and r["method"] == method] for method in CHAINS]

        def pair(key: str, form: str, both: list[list[dict[str, Any]]] = both) -> str:
            return " → ".join(_mean_and_deviation([row[key] for row in part], form) for part in both)

        genus = " → ".join("/".join(sorted({str(row["genus"]) for row in part})) or "–" for part in both)
        lines.append(
            f"| {half} | {name} | {pair('chamfer', '.4f')} | {pair('normals_deg', '.1f')} | "
            f"{genus} ({next(row for part in both for row in part)['true_genus']}) | {pair('cpu_seconds', '.0f')} |"
        )
    return "\n".join(lines)


def _mean_and_deviation(values: list[float], form: str) -> str:
    if not values:
        return "–"
    mean = format(float(np.mean(values)), form)
    return mean if len(values) < 2 else f"{mean} ± {format(float(np.std(values, ddof=1)), form)}"


def main() -> None:
    options = study_arguments(__doc__, Path("benchmarks/results/mesh_chains.jsonl"), table)
    plugins = PluginManager.discover()
    known = {(row["capture"], row["method"], row["seed"]) for row in stored_rows(options.store)}
    for path in options.captures:
        for method in CHAINS:
            for seed in options.seeds:
                if (path.name, method, seed) not in known:
                    add_rows(options.store, [measured(path, method, seed, plugins)])


if __name__ == "__main__":
    main()
