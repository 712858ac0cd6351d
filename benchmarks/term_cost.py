"""What regularizers cost in a fit, and what they bring on views left out: `python -m benchmarks.term_cost CAPTURE…`.

On the true mesh of captures of the materials benchmark, simplified as `hir bench materials` does, the same model with
a map of specular albedo is fitted from the same start without a term and with each. The weight of `bilateral_specular`
is the paper's: 1 against a tenth of the sum of errors over one view. Result: docs/studies/cost_of_terms.md.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from benchmarks.reflectance_task import task_of
from hir_core.optimization.weighted_energies import PIXELS_OF_A_WEIGHT, solver_terms
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Mesh, Topology
from hir_core.stages.held_out_views import model_selection_folds
from hir_plugins.commands.bench.inputs.simplified_truth import TRIANGLES, write_simplified
from hir_plugins.reflectance_renderers.transport_ggx.fit import fit_terms
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

START = ModelSpec("dielectric", "uniform", bounces=1)
FITTED = ModelSpec("dielectric", "map", bounces=1)
SMALL: Mapping[str, Any] = {"pixels": 40_000, "cache_cells": 1500, "vertices": 0}
PAPER_SHARE = 0.1
"""Of the error of a view's pixels, against which the paper's weight of 1 counts."""


def study(path: Path, effort: float, seed: int, triangles: int, options: Mapping[str, Any]) -> None:
    """Rows for one capture."""
    task = task_of(path, downsample=1)
    start_scene = replace(task.start, mesh=_simplified(task.start.mesh, triangles))
    renderer = task.plugins.create("reflectance_renderer", "transport_ggx", options, seed)
    solver = renderer.prepare(start_scene, task.train, 1)
    assert isinstance(solver, TransportSolver)
    views, held_out = model_selection_folds(len(task.train.views))[0]
    start = solver.fit(START, None, views, effort / 4, lambda share: None)
    pixels = len(solver._pixels.of(views)) / len(views)
    paper = PIXELS_OF_A_WEIGHT / pixels / PAPER_SHARE
    terms: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
        "no term": {},
        f"`bilateral_specular`, {paper:.0f}": {"bilateral_specular": {"weight": paper}},
    }
    print(f"\n{path.name}: {len(solver._transport.surface.positions)} vertices, {pixels:.0f} pixels in a view\n")
    print("| | fit, s | term, s | adds | dB, fitted views | dB, views left out | gain there |")
    print("|---|---|---|---|---|---|---|")
    without: tuple[float, NDArray[np.float64]] | None = None
    for name, tables in terms.items():
        seconds: dict[str, float] = {}
        created = solver_terms(tables, task.plugins, seed, seconds)
        chosen = solver.with_terms(created) if created else solver
        chosen._pixels.of(views)  # decoded before the time is taken
        began = time.process_time()
        fit = chosen.fit(FITTED, start, views, effort, lambda share: None)
        spent = time.process_time() - began
        fitted, unseen = (-10 * np.log10(chosen.errors(fit, part)) for part in (views, held_out))
        without = without or (spent, unseen)
        gain = unseen - without[1]
        error = gain.std(ddof=1) / len(gain) ** 0.5
        print(
            f"| {name} | {spent:.1f} | {sum(seconds.values()):.1f} | {100 * (spent / without[0] - 1):+.0f} % | "
            f"{fitted.mean():.2f} | {unseen.mean():.2f} | {gain.mean():+.3f} ± {error:.3f} |",
            flush=True,
        )


def _simplified(mesh: Mesh, triangles: int) -> Mesh:
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder) / "true.obj", Path(folder) / "simplified.ply"
        trimesh.Trimesh(mesh.positions.numpy(), mesh.faces.numpy(), process=False).export(files[0])
        write_simplified(*files, triangles)
        loaded: Any = trimesh.load(files[1], force="mesh", process=False)
    faces = torch.from_numpy(np.asarray(loaded.faces, dtype=np.int64))
    return Mesh(torch.from_numpy(np.asarray(loaded.vertices, dtype=np.float32)), Topology(faces))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--effort", type=float, default=1.0, help="fraction of a full fit's steps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--triangles", type=int, default=TRIANGLES)
    parser.add_argument("--small", action="store_true", help="40,000 pixels, 1,500 cells, vertices of the mesh itself")
    parser.add_argument("--lag", type=int, default=fit_terms.LAG_STEPS, help="steps between evaluations of the term")
    given = parser.parse_args()
    torch.set_num_threads(1)
    fit_terms.LAG_STEPS = given.lag
    for path in given.captures:
        study(path, given.effort, given.seed, given.triangles, SMALL if given.small else {})


if __name__ == "__main__":
    main()
