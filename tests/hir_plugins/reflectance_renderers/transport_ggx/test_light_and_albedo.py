"""The separation of shading and albedo: a uniform grey ball under a light from above."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx.fit import fit_settings
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_guess import METAL_REFLECTANCE
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


def test_a_lamp_changes_no_initial_brightness() -> None:
    """A darker albedo would be a head start: under a lamp and a light that are both as bright it was half as large."""
    solver, _ = solver_of()
    pixels = solver._pixels.of(range(6))
    without, lamp = (solver._initial_parameters(spec, None, pixels) for spec in (ModelSpec(), ModelSpec(lamp=True)))
    assert float(lamp.base_color.mean() / without.base_color.mean()) == pytest.approx(1, abs=0.2)


METAL = ModelSpec("metallic", "uniform", metalness="metal")


def test_a_metal_starts_with_one_bright_base_colour_and_what_the_photographs_show() -> None:
    """Base colour times light is what a diffuse fit starts from; only the first is known to be bright."""
    solver, middle = solver_of()
    pixels = solver._pixels.of(range(6))
    diffuse, metal = (solver._initial_parameters(spec, None, pixels) for spec in (ModelSpec(), METAL))
    assert float(metal.base_color.std(dim=0).max()) < 1e-6
    assert float(metal.base_color.max()) == pytest.approx(METAL_REFLECTANCE, abs=1e-5)
    shown = [(each.radiance.mean((0, 1)) * each.base_color[0]) for each in (diffuse, metal)]
    torch.testing.assert_close(shown[1], shown[0], rtol=1e-3, atol=1e-5)
    known = solver._initial_parameters(replace(METAL, light_is_known=True), None, pixels)
    assert torch.equal(known.light, diffuse.light), "a known light stays"
    assert float(known.base_color[middle].log().std(dim=0).mean()) > 0.1


@pytest.mark.parametrize(("share", "moves"), [(1.0, False), (0.5, True)])
def test_the_base_colour_of_a_metal_moves_after_its_light(
    share: float, moves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_settings, "METAL_COLOR_FROZEN_SHARE", share)
    solver, _ = solver_of()
    fit = solver.fit(METAL, None, range(6), 0.2, lambda _: None)
    assert (float(fit.parameters.base_color.std(dim=0).max()) > 1e-3) is moves
    assert float(fit.parameters.light.std()) > 1e-3
    further = solver.fit(METAL, fit, range(6), 0.05, lambda _: None)
    assert not torch.equal(further.parameters.diffuse, fit.parameters.diffuse), "a fit that goes on moves all"


def test_a_fit_that_goes_on_stays_near_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Adam's first steps are as long as the rate however small the gradient; the warm-up keeps them short.

    Without the entropy of the albedo, which the fit before has not minimised.
    """
    solver, _ = solver_of(albedo_entropy=0.0)
    before = solver.fit(ModelSpec(), None, range(6), 2.0, lambda _: None)
    error = {}
    for share in (0.0, 0.2):
        monkeypatch.setattr(fit_settings, "WARM_UP_SHARE", share)
        after = solver.fit(ModelSpec(), before, range(6), 0.1, lambda _: None)
        error[share] = float(solver.errors(after, range(6)).mean())
    assert error[0.2] < 0.75 * error[0.0], error


def test_a_lobe_that_is_new_has_no_warm_up() -> None:
    light, width, one = torch.zeros(2, 4, 3), torch.zeros(1, 1), torch.zeros(5, 1)
    diffuse = Parameters(light, torch.zeros(5, 3), None, None)
    dielectric = replace(diffuse, specular=width, width=width)
    metal = replace(dielectric, metalness=torch.full((1, 1), torch.inf))
    mixed = replace(dielectric, metalness=one)
    goes_on = [(diffuse, diffuse), (dielectric, dielectric), (metal, metal), (mixed, mixed), (diffuse, mixed)]
    assert not any(after.has_new_lobe(before) for after, before in goes_on)
    new = [(dielectric, diffuse), (mixed, metal), (mixed, dielectric), (metal, diffuse), (metal, dielectric)]
    assert all(after.has_new_lobe(before) for after, before in new)


def test_the_albedo_waits_for_an_unknown_light(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the full rate more of the shading of a grey ball is in its albedo."""
    deviations = {}
    slow = fit_settings.FIRST_ALBEDO_SHARE
    for share in (1.0, slow):
        monkeypatch.setattr(fit_settings, "FIRST_ALBEDO_SHARE", share)
        solver, middle = solver_of()
        fit = solver.fit(ModelSpec(), None, range(6), 0.2, lambda _: None)
        deviations[share] = log_albedo_deviation(fit.parameters, middle)
    assert deviations[slow] < deviations[1.0], deviations


def test_a_piecewise_constant_albedo_is_preferred() -> None:
    deviations = []
    for weight in (1e-3, 0.0):
        solver, middle = solver_of(albedo_smoothness=weight)
        deviations.append(
            log_albedo_deviation(solver.fit(ModelSpec(), None, range(6), 1.0, lambda _: None).parameters, middle)
        )
    assert deviations[0] < 0.85 * deviations[1]
