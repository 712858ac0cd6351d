"""Loss against the width of a lobe, for fixed and for new directions: `python -m benchmarks.lobe_width CAPTURE`.

On the true mesh of a capture of the materials benchmark, with its true kind of material and light. Then fits that start
at several widths. Result: docs/studies/lobe_width.md.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import torch

from benchmarks.reflectance_task import capture_argument, task_of
from hir_core.stages.held_out_views import model_selection_folds
from hir_core.stages.reflectance.selection.hypotheses import hypothesis
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import sample_loss
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import logit_of_alpha
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

RATIOS = (0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5)
INITIAL_ALPHAS = (0.05, 0.15, 0.4)


def main() -> None:
    task = task_of(capture_argument(__doc__), downsample=1)
    truth = json.loads((task.path / "truth.json").read_text())
    spec = hypothesis(truth["kind"], truth["light_frame"])
    solver = task.plugins.create("reflectance_renderer", "transport_ggx", {}).prepare(task.start, task.train, 1)
    assert isinstance(solver, TransportSolver)
    fitted_views, held_out = model_selection_folds(len(task.train.views))[0]
    first = solver.fit(spec, None, fitted_views, 0.2, lambda share: None, pixel_share=0.5)
    print("| initial α | α | dB, fitted views | dB, views left out | by path tracing |\n|---|---|---|---|---|")
    for start in INITIAL_ALPHAS:
        moved = replace(first.parameters, width=logit_of_alpha(torch.full((1, 1), start)))
        fit = solver.fit(spec, replace(first, parameters=moved), fitted_views, 1.0, lambda share: None)
        db = [-10 * np.log10(solver.errors(fit, views)).mean() for views in (fitted_views, held_out)]
        found = task.evaluator(solver.scene(fit, fitted_views, lambda share: None).scene, spec.bounces)
        errors = ", ".join(f"{name} {value:.1f}" for name, value in found.items())
        print(f"| {start} | {float(fit.parameters.alpha):.3f} | {db[0]:.2f} | {db[1]:.2f} | {errors} |", flush=True)
    print_profile(solver, fit, fitted_views)


def print_profile(solver: TransportSolver, fit: Fit, views: list[int]) -> None:
    """The loss around the fitted width: weights of directions that were drawn there, and directions drawn anew."""
    settings = FitSettings(1, fit.spec.brdf, fit.spec.bounces)
    batches = solver._pixels.batches(solver._pixels.of(views), fit.spec)
    drawn = batches.sample(fit.parameters)
    alpha = float(fit.parameters.alpha)
    print("\n| α / fitted α | fixed directions | drawn anew |\n|---|---|---|")
    for ratio in RATIOS:
        moved = replace(fit.parameters, width=logit_of_alpha(torch.full((1, 1), alpha * ratio)))
        fixed = replace(batches, sample=lambda _: drawn)
        with torch.no_grad():
            losses = [sample_loss(solver._transport, each, moved, settings) for each in (fixed, batches)]
        print(f"| {ratio} | {losses[0]:.3e} | {losses[1]:.3e} |", flush=True)


if __name__ == "__main__":
    main()
