"""The separation of shading and albedo: a uniform grey ball under a light from above."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_exposures_and_energy import photographs


def solver_of(**options: Any) -> tuple[Any, torch.Tensor]:
    """A solver, and the vertices near the ball's equator, which all photographs show well."""
    capture, scene = photographs(np.ones(6))
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800, steps=150, **options)).prepare(
        scene, capture
    )
    return solver, scene.mesh.positions[:, 1].abs() < 0.6


def log_albedo_deviation(parameters: Parameters, middle: torch.Tensor) -> float:
    """Standard deviation of log albedo."""
    return float(parameters.diffuse_albedo[middle].log().std(dim=0).mean())


@pytest.mark.parametrize(
    ("options", "known", "uniform"),
    [({}, False, True), ({"initial_albedo": "photographs"}, False, False), ({}, True, False)],
)
def test_the_initial_albedo_is_uniform_unless_set_otherwise_or_the_light_is_known(
    options: dict[str, Any], known: bool, uniform: bool
) -> None:
    solver, middle = solver_of(**options)
    deviation = log_albedo_deviation(
        solver._initial_parameters(ModelSpec(light_is_known=known), None, solver._pixels.of(range(6))), middle
    )
    assert deviation < 1e-6 if uniform else deviation > 0.1


def test_a_piecewise_constant_albedo_is_preferred() -> None:
    deviations = []
    for weight in (1e-3, 0.0):
        solver, middle = solver_of(albedo_smoothness=weight)
        deviations.append(
            log_albedo_deviation(solver.fit(ModelSpec(), None, range(6), 1.0, lambda _: None).parameters, middle)
        )
    assert deviations[0] < 0.85 * deviations[1]
