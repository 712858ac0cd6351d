"""Fits of a metal by the number of directions of its lobes: `python -m benchmarks.metal_directions CAPTURE…`.

On the true mesh of captures of the materials benchmark, with their true kind of material and light frame, by the rounds
of the model selection and a full fit. Prints one line of JSON for each number of directions (`samples`; a metal's lobes
have `METAL_DIRECTIONS` times as many): held-out PSNR as the mean square of one draw of the lobes (with the noise of its
directions), as the solver compares models (without it), and with 128 of them; unseen and relit views; processor seconds
of the fit.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.reflectance_task import Task, task_of
from benchmarks.stored_rows import provenance
from hir_core.metrics import mean
from hir_core.stages.held_out_views import held_out_for_model_selection
from hir_core.stages.reflectance.selection.held_out_comparison import mean_decibels
from hir_core.stages.reflectance.selection.hypotheses import hypothesis
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS, Budget
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import srgb_residual
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

REFERENCE_DIRECTIONS = 128
FULL = Budget(1.0, 1.0)


def solver_with(task: Task, directions: int, seed: int) -> TransportSolver:
    """A solver of that many directions."""
    solver = task.plugins.create("reflectance_renderer", "transport_ggx", {"samples": directions}, seed).prepare(
        task.start, task.train, 1
    )
    assert isinstance(solver, TransportSolver)
    return solver


def noisy_errors(solver: TransportSolver, fit: Fit, views: list[int]) -> np.ndarray:
    """Mean squares of one draw of the lobes for each view."""
    pixels, renderings = solver._renderings(fit, views)
    square = srgb_residual(pixels, renderings[0].clamp(0, 1)).square().mean(dim=1).cpu().numpy()
    view = pixels.view.cpu().numpy()
    return np.array([square[view == v].mean() for v in views])


def row(task: Task, truth: dict[str, Any], directions: int, seed: int) -> dict[str, Any]:
    """One fit and its figures."""
    training, held_out = held_out_for_model_selection(len(task.train.views))
    spec = hypothesis(truth["kind"], truth["light_frame"])
    solver, fit, started = solver_with(task, directions, seed), None, time.process_time()
    for budget in (*ROUNDS, FULL):
        fit = solver.fit(spec, fit, training, budget.effort, lambda share: None, None, budget.pixel_share)
    seconds = time.process_time() - started
    assert fit is not None
    exact = solver_with(task, REFERENCE_DIRECTIONS, seed + 1)
    shown = task.evaluator(solver.scene(fit, training, lambda share: None).scene, spec.bounces)
    relit = mean([value for name, value in shown.items() if name.startswith("relight")])
    figures = {
        "one draw": mean_decibels(noisy_errors(solver, fit, list(held_out))),
        "compared": mean_decibels(solver.errors(fit, held_out)),
        f"{REFERENCE_DIRECTIONS} directions": mean_decibels(exact.errors(fit, held_out)),
        "unseen, object": shown["unseen dB"],
        "relit, scaled, frame": relit,
        "alpha": float(fit.parameters.alpha.mean()),
        "CPU s": seconds,
    }
    return {"directions": directions, "seed": seed} | {k: round(float(v or 0.0), 3) for k, v in figures.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--directions", default="16,32")
    parser.add_argument("--seeds", default="0")
    options = parser.parse_args()
    torch.set_num_threads(1)
    for path in options.captures:
        task = task_of(path, downsample=1)
        truth = json.loads((path / "truth.json").read_text())
        about = {
            "capture": path.name,
            "kind": truth["kind"],
            **provenance(),
        }
        for seed in map(int, options.seeds.split(",")):
            for directions in map(int, options.directions.split(",")):
                print(json.dumps(row(task, truth, directions, seed) | about), flush=True)


if __name__ == "__main__":
    main()
