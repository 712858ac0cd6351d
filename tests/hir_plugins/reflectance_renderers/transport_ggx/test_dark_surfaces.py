"""The scale between albedo and light where a lobe is new: highlights tell it, within the limits of F0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial import initial_guess
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_guess import (
    BRIGHTER_LIGHTS,
    initial_candidates,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.measured_scale import with_brighter_light
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.made_captures import TEXELS, around, lamps, make_material, photographs
from tests.fixtures.scenes import icosphere

DIELECTRIC = ModelSpec("dielectric", "uniform")
ALBEDO = 0.02
FITTED = range(8)


def parameters(lobe: bool) -> Parameters:
    one = torch.zeros(1, 1) if lobe else None
    lamp = torch.arange(8.0)
    return Parameters(torch.zeros(2, 4, 3), torch.logit(torch.full((5, 3), 0.4)), one, one, lamp=lamp)


def test_a_diffuse_surface_looks_the_same_under_a_brighter_light() -> None:
    before, gain = parameters(False), torch.tensor([3.0, 4.0, 5.0])
    after = with_brighter_light(before, gain)
    torch.testing.assert_close(after.radiance[0, 0] * after.base_color[0], before.radiance[0, 0] * before.base_color[0])
    torch.testing.assert_close(after.radiance, before.radiance * gain)
    found, lamp = after.camera_lamp, before.camera_lamp
    assert found is not None and lamp is not None
    torch.testing.assert_close(found.intensity, lamp.intensity * gain)
    assert all(torch.equal(getattr(found, name), getattr(lamp, name)) for name in ("offset", "exponent", "radius"))


@pytest.mark.parametrize(
    ("spec", "earlier", "known", "count"),
    [
        (DIELECTRIC, parameters(False), False, 1 + len(BRIGHTER_LIGHTS)),
        (DIELECTRIC, parameters(False), True, 1),
        (DIELECTRIC, parameters(True), False, 1),
        (DIELECTRIC, None, False, 1),
        (ModelSpec("paper", "uniform"), parameters(False), False, 1),
    ],
    ids=["the lobe is new", "a card gives the scale", "the fit goes on", "no earlier fit", "ρs has no limit"],
)
def test_other_scales_are_tried_where_highlights_are_new_and_nothing_else_tells_it(
    spec: ModelSpec, earlier: Parameters | None, known: bool, count: int
) -> None:
    assert len(initial_candidates(spec, parameters(True), earlier, known)) == count


@pytest.mark.parametrize("albedo", [ALBEDO, pytest.param(0.4, marks=pytest.mark.slow)])
def test_the_scale_of_a_dark_glossy_ball_is_found_and_a_bright_one_keeps_its_own(
    albedo: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mean albedo and PSNR of views left out, with other scales tried and without."""
    mesh, _ = unwrap_mesh(icosphere(3), TEXELS)
    truth = Scene(mesh, make_material((albedo, albedo, albedo), 0.04, 0.2, "dielectric"), lamps())
    capture = photographs(truth, around(12))
    grey = make_material(torch.full((TEXELS, TEXELS, 3), 0.5), 0.04, 0.3, "dielectric")
    start = replace(truth, material=grey)
    assert truth.environment is not None
    seen = float(np.mean([v.pixels().color_linear[v.pixels().mask > 0.99].mean() for v in capture.views]))  # type: ignore[operator]
    # a light that shows the photographs with a mean albedo of 0.3, as a run starts
    even = torch.full_like(truth.environment.radiance, seen / 0.3)
    start = replace(start, environment=replace(truth.environment, radiance=even))
    found = {}
    for gains in ((), BRIGHTER_LIGHTS):
        monkeypatch.setattr(initial_guess, "BRIGHTER_LIGHTS", gains)
        solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=300, steps=100)).prepare(start, capture)
        fit = solver.fit(DIELECTRIC, None, FITTED, 1.0, lambda share: None)
        unseen = -10 * np.log10(solver.errors(fit, range(len(FITTED), 12)).mean())
        found[gains] = float(fit.parameters.base_color.mean()), unseen
    without, tried = found[()], found[BRIGHTER_LIGHTS]
    if albedo == ALBEDO:
        assert tried[0] < 0.5 * without[0] and tried[1] > without[1] + 3, found
    else:
        assert tried == without, found
