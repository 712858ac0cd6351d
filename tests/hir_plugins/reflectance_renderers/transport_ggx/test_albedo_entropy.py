"""The entropy of the albedo: its value, its gradient, and what it does for a surface of few colours."""

from __future__ import annotations

import math

import pytest
import torch

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx.fit import albedo_entropy as module
from hir_plugins.reflectance_renderers.transport_ggx.fit.albedo_entropy import albedo_entropy
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import settings_of_fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import (
    log_albedo_deviation,
    solver_of,
)


def test_value_and_gradient_are_those_of_all_pairs() -> None:
    x = torch.randn(40, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    value = module._QuadraticEntropy.apply(x)
    pairs = torch.exp(-(x[:, None] - x).square().sum(dim=2) / 4)
    torch.testing.assert_close(value, -pairs.mean().log())
    assert torch.autograd.gradcheck(module._QuadraticEntropy.apply, (x,))


@pytest.mark.parametrize("colors", [1, 2, 8])
def test_equally_frequent_colours_that_differ_have_the_entropy_of_their_number(colors: int) -> None:
    albedo = torch.logspace(-2, -0.1, colors)
    logit = torch.logit(albedo)[torch.arange(4096) % colors][:, None].expand(-1, 3)
    assert float(albedo_entropy(logit, (0, 3))) == pytest.approx(math.log(colors), abs=0.02)


def test_a_factor_of_all_albedos_changes_nothing() -> None:
    albedo = 0.05 + 0.4 * torch.rand(3000, 3, generator=torch.Generator().manual_seed(0))
    values = [float(albedo_entropy(torch.logit(factor * albedo), (0, 5))) for factor in (1.0, 0.3, 2.0)]
    assert values == pytest.approx([values[0]] * 3, rel=1e-4)


@pytest.mark.parametrize("seed", [(0, 1), (1, 0), (2**31, 199)])
def test_the_sample_depends_on_fit_and_step_alone(seed: tuple[int, int]) -> None:
    logit = torch.randn(5000, 3, generator=torch.Generator().manual_seed(0))
    assert float(albedo_entropy(logit, seed)) == float(albedo_entropy(logit, seed))
    assert float(albedo_entropy(logit, seed)) != float(albedo_entropy(logit, (0, 0)))


@pytest.mark.parametrize("values", [(0.0, 0.0), (-1e4, 1e4), (-40.0, -60.0)])
@pytest.mark.parametrize("count", [1, 7])
def test_white_black_and_equal_albedos_have_a_finite_gradient(values: tuple[float, float], count: int) -> None:
    logit = torch.tensor(values)[torch.arange(count) % 2][:, None].repeat(1, 3).requires_grad_()
    value = albedo_entropy(logit, (0, 0))
    value.backward()  # type: ignore[no-untyped-call]
    assert math.isfinite(float(value.detach())) and float(value.detach()) >= -1e-5
    assert logit.grad is not None and bool(torch.isfinite(logit.grad).all())


def test_shading_is_attributed_to_the_light() -> None:
    """More of the shading of a grey ball is in its albedo without the prior."""
    deviations = []
    for weight in (3e-5, 0.0):
        solver, middle = solver_of(albedo_entropy=weight, albedo_smoothness=0.0)
        fit = solver.fit(ModelSpec(), None, range(6), 0.9, lambda _: None)
        deviations.append(log_albedo_deviation(fit.parameters, middle))
    assert deviations[0] < 0.7 * deviations[1], deviations


@pytest.mark.parametrize(
    ("effort", "known", "acts"), [(0.4, False, True), (0.4, True, False), (1.0, False, False), (2.0, False, False)]
)
def test_it_acts_before_the_last_fit_under_an_unknown_light(effort: float, known: bool, acts: bool) -> None:
    options, spec = TransportGGXOptions(), ModelSpec(light_is_known=known)
    start = Parameters(torch.zeros(2, 4, 3), torch.zeros(5, 3), None, None)
    settings = settings_of_fit(options, spec, start, None, effort, guess_is_uniform=True)
    assert settings.albedo_entropy == (options.albedo_entropy if acts else 0)
