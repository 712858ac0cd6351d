"""The studies behind docs/reflectance.md: that they measure what they say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from benchmarks.alternation import LightProblem
from benchmarks.remaining_error import seen_from
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import refresh_matrices, specular_matrices
from hir_plugins.reflectance_renderers.transport_ggx.solver import Fit
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import solver_of


def light_problem(rung: ModelSpec) -> tuple[Any, Parameters, LightProblem]:
    """A ball with what its photographs begin with, in several blocks."""
    solver, _ = solver_of(block_pixels=400)
    photographs = solver._photographs(range(6))
    parameters = solver._begin(rung, None, photographs)
    stream = solver._stream(photographs, rung)
    blocks = [stream.make(parameters, number) for number in range(stream.count)]
    specular = specular_matrices(blocks, rung.brdf)
    refresh_matrices(blocks, specular, parameters)
    return solver, parameters, LightProblem(solver._transport, blocks, specular, parameters, rung.bounces)


@pytest.mark.parametrize("rung", [ModelSpec(), ModelSpec("dielectric", "uniform", bounces=1)])
def test_the_light_in_closed_form_shows_what_was_photographed(rung: ModelSpec) -> None:
    solver, parameters, problem = light_problem(rung)
    found = problem.solution()
    assert bool((found > 0).all()) and bool(torch.isfinite(found).all())
    before = solver.errors(Fit(rung, parameters), range(6)).mean()
    after = solver.errors(Fit(rung, replace(parameters, light=found.log())), range(6)).mean()
    assert after < 0.2 * before


def test_what_a_light_shows_is_linear_and_its_transpose_is_one() -> None:
    """⟨A x, y⟩ = ⟨x, Aᵀ y⟩, which conjugate gradients rely on."""
    _, parameters, problem = light_problem(ModelSpec("dielectric", "uniform", bounces=1))
    torch.manual_seed(0)
    light = torch.rand_like(parameters.light)
    shown = problem._shown(light)
    weights = [torch.rand_like(values) for values in shown]
    left = sum(float((a * b).sum()) for a, b in zip(shown, weights, strict=True))
    assert left == pytest.approx(float((light * problem._transposed(weights)).sum()), rel=1e-3)


def test_a_light_seen_from_itself_is_itself() -> None:
    even = EnvironmentMap(torch.full((16, 32, 3), 0.7), torch.eye(3))
    assert torch.allclose(seen_from(even, 8), torch.full((8, 16, 3), 0.7))
    bright = torch.zeros(16, 32, 3)
    bright[4:6, 10:12] = 1.0
    assert float(seen_from(EnvironmentMap(bright, torch.eye(3)), 16).sub(bright).abs().max()) < 1e-6
