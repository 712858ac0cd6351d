"""Error of a specular lobe by the number of its directions, their pattern and the level of the light that they read.

`python -m benchmarks.lobe_directions CAPTURE [--kind metal]` on a capture with a true mesh: fits light and material
with 64 directions, then compares the radiance of one held-out view with 1,024 directions that read the finest level.
Prints one line of JSON for each pattern and level: PSNR in sRGB by the number of directions. Then the error of the one
matrix that all colour channels share against one for each channel, and the relative error of the irradiance from the
hemisphere's directions, which a light on the camera needs, against 8,192 of them.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.reflectance_task import Task, task_of
from benchmarks.stored_rows import provenance
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.held_out_views import held_out_for_model_selection
from hir_core.stages.reflectance.selection.hypotheses import KINDS, hypothesis
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import logit_of_alpha
from hir_plugins.reflectance_renderers.transport_ggx.operator import camera_light
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes import specular_lobes, spiral, traced_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

Pattern = Callable[[int, int, int, torch.device], Tensor]
FITTED_DIRECTIONS = 64
REFERENCE_DIRECTIONS = 1_024
REFERENCE_OF_HEMISPHERE = 8_192
HEMISPHERES = (48, 96, 192)
"""Directions; 96 is the default of `diffuse_samples`."""
FINEST_LEVEL = -20.0
"""A level offset with which every direction reads the finest level."""


def r2_points(count: int, samples: int, seed: int, device: torch.device) -> Tensor:
    """The R2 sequence (Roberts 2018), even on the unit square, moved at random for each pixel."""
    generator = torch.Generator().manual_seed(seed)
    shift = torch.rand(count, 1, 2, generator=generator, dtype=torch.float64).to(device)
    index = torch.arange(samples, device=device, dtype=torch.float64)
    step = torch.tensor([0.7548776662466927, 0.5698402909980532], device=device, dtype=torch.float64)
    return ((index[:, None] * step)[None] + shift).remainder(1).float()


def random_points(count: int, samples: int, seed: int, device: torch.device) -> Tensor:
    """Independent points."""
    return torch.rand(count, samples, 2, generator=torch.Generator().manual_seed(seed)).to(device)


PATTERNS: dict[str, Pattern] = {
    "random": random_points,
    "R2": r2_points,
    "spiral": spiral.spiral_points,
}


@contextmanager
def drawn_with(pattern: Pattern, level_offset: float) -> Iterator[None]:
    """Lobes with another pattern of directions that read the light `level_offset` levels coarser."""
    points = spiral.spiral_points
    specular_lobes.spiral_points = camera_light.spiral_points = pattern
    traced_directions.LEVEL_OFFSET = level_offset
    try:
        yield
    finally:
        specular_lobes.spiral_points = camera_light.spiral_points = points
        traced_directions.LEVEL_OFFSET = 0.0


def solver_with(task: Task, directions: int) -> TransportSolver:
    """A solver whose lobes have this number of directions; all of them compare the same pixels."""
    renderer = task.plugins.create("reflectance_renderer", "transport_ggx", {"samples": directions}, 0)
    solver = renderer.prepare(task.start, task.train, 1)
    assert isinstance(solver, TransportSolver)
    return solver


@contextmanager
def matrix_of_channel(channel: int) -> Iterator[None]:
    """Matrices of lobes with Fresnel's term of one channel, for which they are exact."""
    refresh = SpecularMatrices.refresh

    def of_channel(matrices: SpecularMatrices, alpha: Tensor, rho_s: Tensor, normal: Tensor | None = None) -> None:
        refresh(matrices, alpha, rho_s[:, min(channel, rho_s.shape[1] - 1)][:, None], normal)

    SpecularMatrices.refresh = of_channel  # type: ignore[method-assign]
    try:
        yield
    finally:
        SpecularMatrices.refresh = refresh  # type: ignore[method-assign]


def predicted_by_channel(task: Task, fit: Fit, view: int, directions: int) -> Tensor:
    """As `predicted`, with a matrix for each channel."""
    columns = []
    for channel in range(3):
        with matrix_of_channel(channel):
            columns.append(predicted(task, fit, view, directions)[:, channel])
    return torch.stack(columns, dim=1)


def predicted(task: Task, fit: Fit, view: int, directions: int) -> Tensor:
    """sRGB colours (P, 3) of the pixels that are compared in a view."""
    solver = solver_with(task, directions)
    parts = [radiance for _, radiance in solver._predicted(fit, solver._pixels.compared([view]))]
    return linear_to_srgb(torch.cat(parts).clamp(0, 1))


def hemisphere_errors(solver: TransportSolver, fit: Fit, view: int) -> Iterator[dict[str, Any]]:
    """Relative root mean square error of the irradiance at the pixels of a view, under the fitted light."""
    points, transport = solver._pixels.compared([view]).points, solver._transport
    light = transport.pyramid.flatten(fit.parameters.radiance.detach())
    sources = torch.cat([light, light.new_zeros(len(transport.irradiance_cache), 3)])

    def irradiance(pattern: Pattern, directions: int) -> Tensor:
        with drawn_with(pattern, 0.0):
            return camera_light.irradiance_of(transport, points, directions, solver._rotation, sources)

    reference = irradiance(spiral.spiral_points, REFERENCE_OF_HEMISPHERE)
    for name, pattern in PATTERNS.items():
        errors = {n: irradiance(pattern, n) - reference for n in HEMISPHERES}
        yield {
            "pattern": name,
            "irradiance_error": {n: round(float(e.norm() / reference.norm()), 4) for n, e in errors.items()},
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--kind", choices=KINDS, default="metal")
    parser.add_argument("--alphas", default="0.09,0.3", help="widths of the lobe that are compared")
    parser.add_argument("--levels", default="0,-0.25,-0.5,0.5")
    parser.add_argument("--directions", default="16,24,32")
    options = parser.parse_args()
    torch.set_num_threads(1)
    task = task_of(options.capture, downsample=1)
    training, held_out = held_out_for_model_selection(len(task.train.views))
    solver, fit = solver_with(task, FITTED_DIRECTIONS), None
    for budget in ROUNDS:
        spec = hypothesis(options.kind, "world")
        fit = solver.fit(spec, fit, training, budget.effort, lambda share: None, None, budget.pixel_share)
    assert fit is not None
    about = {
        "capture": options.capture.name,
        "kind": options.kind,
        **provenance(),
    }
    for alpha in map(float, options.alphas.split(",")):
        lobe = replace(fit, parameters=replace(fit.parameters, width=logit_of_alpha(torch.tensor([[alpha]]))))
        with drawn_with(spiral.spiral_points, FINEST_LEVEL):
            reference = predicted(task, lobe, held_out[0], REFERENCE_DIRECTIONS)
        for name, pattern in PATTERNS.items():
            for level in map(float, options.levels.split(",")):
                errors = {}
                for directions in map(int, options.directions.split(",")):
                    with drawn_with(pattern, level):
                        error = predicted(task, lobe, held_out[0], directions) - reference
                    errors[directions] = round(-10 * math.log10(float(error.square().mean())), 2)
                row = {"alpha": alpha, "pattern": name, "level_offset": level, "dB": errors}
                print(json.dumps(row | about), flush=True)
        exact = predicted_by_channel(task, lobe, held_out[0], FITTED_DIRECTIONS)
        error = predicted(task, lobe, held_out[0], FITTED_DIRECTIONS) - exact
        one = round(-10 * math.log10(max(float(error.square().mean()), 1e-12)), 2)
        print(json.dumps({"alpha": alpha, "one_matrix_dB": one} | about), flush=True)
    for row in hemisphere_errors(solver, fit, held_out[0]):
        print(json.dumps(row | about), flush=True)


if __name__ == "__main__":
    main()
