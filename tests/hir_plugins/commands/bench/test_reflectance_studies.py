"""The studies of docs/reflectance.md: closed-form light, and light seen from the cameras."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from benchmarks.alternation import LightProblem
from benchmarks.remaining_error import seen_from
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    refresh_matrices,
    specular_matrices,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import solver_of


def light_problem(spec: ModelSpec) -> tuple[Any, Parameters, LightProblem]:
    """A sphere with the initial parameters of its fit, in several mini-batches."""
    solver, _ = solver_of(block_pixels=400)
    photographs = solver._pixels.of(range(6))
    parameters = solver._initial_parameters(spec, None, photographs)
    batches = solver._pixels.batches(photographs, spec)
    blocks = [batches.make(parameters, number) for number in range(batches.count)]
    specular = specular_matrices(blocks, spec.brdf)
    refresh_matrices(blocks, specular, parameters)
    return solver, parameters, LightProblem(solver._transport, blocks, specular, parameters, spec.bounces)


@pytest.mark.parametrize("spec", [ModelSpec(), ModelSpec("dielectric", "uniform", bounces=1)])
def test_the_closed_form_light_reproduces_the_photographs(spec: ModelSpec) -> None:
    solver, parameters, problem = light_problem(spec)
    radiance = problem.solution()
    assert bool((radiance > 0).all()) and bool(torch.isfinite(radiance).all())
    before = solver.errors(Fit(spec, parameters), range(6)).mean()
    after = solver.errors(Fit(spec, replace(parameters, light=radiance.log())), range(6)).mean()
    assert after < 0.2 * before


def test_rendering_is_linear_in_the_light_and_its_transpose_is_the_adjoint() -> None:
    """⟨A x, y⟩ = ⟨x, Aᵀ y⟩, which conjugate gradients rely on."""
    _, parameters, problem = light_problem(ModelSpec("dielectric", "uniform", bounces=1))
    torch.manual_seed(0)
    light = torch.rand_like(parameters.light)
    shown = problem._predicted(light)
    weights = [torch.rand_like(values) for values in shown]
    left = sum(float((a * b).sum()) for a, b in zip(shown, weights, strict=True))
    assert left == pytest.approx(float((light * problem._transposed(weights)).sum()), rel=1e-3)


def test_a_light_resampled_in_its_own_frame_is_unchanged() -> None:
    uniform = EnvironmentMap(torch.full((16, 32, 3), 0.7), torch.eye(3))
    assert torch.allclose(seen_from(uniform, 8), torch.full((8, 16, 3), 0.7))
    bright = torch.zeros(16, 32, 3)
    bright[4:6, 10:12] = 1.0
    assert float(seen_from(EnvironmentMap(bright, torch.eye(3)), 16).sub(bright).abs().max()) < 1e-6
