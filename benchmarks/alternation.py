"""Alternating least squares for albedo and light, against gradient steps: `python -m benchmarks.alternation CAPTURE`.

On the true mesh of a capture, with the task and the evaluation of `hir bench reflectance`. With cached visibility and
lobes the image is linear in the albedos and linear in the light: each is a least-squares problem while the other is
fixed. The lobes keep their initial values here; gradient steps fit them, too.
Result: docs/studies/alternating_least_squares.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from benchmarks.reflectance_task import task_from_arguments
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene.srgb import srgb_slope, srgb_to_linear
from hir_plugins.commands.bench.suites.reflectance_fits import DOWNSAMPLE, FITTED_MODEL
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import SRGB_SLOPE_FLOOR_LINEAR, solve_final_albedo
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelBatch,
    predict,
    refresh_matrices,
    specular_matrices,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

ROUNDS = (1, 3, 10)
EFFORTS = (0.0625, 0.25, 1.0)
ITERATIONS = 12
"""Of conjugate gradients for the light, in each round."""
SMOOTHNESS = 0.02
"""Weight of differences between neighbouring texels, relative to the mean weight of a texel's observations."""
MIN_RADIANCE = 1e-6
"""Radiance of a texel that the solution would make negative."""


def main() -> None:
    task = task_from_arguments(__doc__)
    renderer = task.plugins.create("reflectance_renderer", "transport_ggx", {})
    every = range(len(task.train.views))

    def row(name: str, fitted: Callable[[TransportSolver], Fit]) -> None:
        start_time = time.perf_counter()
        solver = renderer.prepare(task.start, task.train, DOWNSAMPLE)
        solved = solver.scene(fitted(solver), every, lambda _: None).scene
        task.row(name, time.perf_counter() - start_time, solved)

    for effort in EFFORTS:
        row(
            f"gradient steps, effort {effort:g}",
            lambda solver, e=effort: solver.fit(
                FITTED_MODEL, None, every, e, _ignore_progress, pixel_share=min(1.0, 2 * e)
            ),
        )
    for rounds in ROUNDS:
        row(f"closed form, {rounds} in turn", lambda solver, n=rounds: Fit(FITTED_MODEL, alternate(solver, every, n)))


def _ignore_progress(share: float) -> None:
    """Discards progress."""


def alternate(solver: TransportSolver, views: Sequence[int], rounds: int) -> Parameters:
    """Solves light, then albedos, `rounds` times, from the initial guess of the gradient steps."""
    photographs = solver._pixels.of(views)
    parameters = solver._initial_parameters(
        FITTED_MODEL, Fit(ModelSpec(), solver._initial_parameters(ModelSpec(), None, photographs)), photographs
    )
    stream = solver._pixels.batches(photographs, FITTED_MODEL)
    blocks = [stream.make(parameters, number) for number in range(stream.count)]
    specular = specular_matrices(blocks, FITTED_MODEL.brdf)
    refresh_matrices(blocks, specular, parameters)
    for _ in range(rounds):
        problem = LightProblem(solver._transport, blocks, specular, parameters, FITTED_MODEL.bounces)
        parameters = replace(parameters, light=problem.solution().log())
        solved = solve_final_albedo(
            solver._transport, zip(blocks, specular, strict=True), parameters, FITTED_MODEL.bounces
        )
        parameters = replace(parameters, diffuse=solved.with_closed_form_albedo.diffuse)
    return parameters


@dataclass(frozen=True, eq=False)
class LightProblem:
    """The light with albedos and lobes fixed: regularised least squares; negative results are clamped."""

    transport: Transport
    blocks: Sequence[PixelBatch]
    specular: Sequence[SpecularMatrices | None]
    parameters: Parameters
    bounces: int

    def solution(self) -> Tensor:
        """Radiance (H, W, 3)."""
        light = self.parameters.radiance
        colors = [srgb_to_linear(block.color_srgb) for block in self.blocks]
        pairs = zip(colors, self.blocks, strict=True)
        weights = [srgb_slope(c.clamp(SRGB_SLOPE_FLOOR_LINEAR, 1)).square() * ~block.saturated for c, block in pairs]
        right = self._transposed([w * c for w, c in zip(weights, colors, strict=True)])
        ones = [w * predicted for w, predicted in zip(weights, self._predicted(torch.ones_like(light)), strict=True)]
        smooth = SMOOTHNESS * self._transposed(ones).mean()

        def apply(x: Tensor) -> Tensor:
            plus, minus = self._predicted(x.clamp_min(0)), self._predicted((-x).clamp_min(0))
            rows = [w * (a - b) for w, a, b in zip(weights, plus, minus, strict=True)]
            return self._transposed(rows) + smooth * _differences(x)

        residual = right - apply(light)
        direction, rho = residual, residual.square().sum()
        for _ in range(ITERATIONS):
            image = apply(direction)
            step = rho / (direction * image).sum().clamp_min(1e-30)
            light, residual = light + step * direction, residual - step * image
            new = residual.square().sum()
            direction, rho = residual + new / rho.clamp_min(1e-30) * direction, new
        return light.clamp_min(MIN_RADIANCE)

    def _predicted(self, radiance: Tensor) -> list[Tensor]:
        """Prediction of each block under a light."""
        lit = replace(self.parameters, light=radiance.clamp_min(1e-20).log())
        with torch.no_grad():
            pairs = zip(self.blocks, self.specular, strict=True)
            return [predict(self.transport, block, matrices, lit, self.bounces) for block, matrices in pairs]

    def _transposed(self, rows: Sequence[Tensor]) -> Tensor:
        radiance = torch.ones_like(self.parameters.light, requires_grad=True)
        total = torch.zeros_like(radiance)
        for block, matrices, values in zip(self.blocks, self.specular, rows, strict=True):
            lit = replace(self.parameters, light=radiance.log())
            predicted = predict(self.transport, block, matrices, lit, self.bounces)
            total = total + torch.autograd.grad(predicted, radiance, values)[0]
        return total


def _differences(light: Tensor) -> Tensor:
    """Gradient of half the squared differences between neighbouring texels; columns go round."""
    across = 2 * light - light.roll(1, 1) - light.roll(-1, 1)
    down = torch.zeros_like(light)
    step = light[1:] - light[:-1]
    down[1:] += step
    down[:-1] -= step
    return across + down


if __name__ == "__main__":
    main()
