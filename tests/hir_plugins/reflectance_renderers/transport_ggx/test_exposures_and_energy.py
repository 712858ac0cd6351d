"""Fits of photographs with different exposures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Capture, Pixels, View
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.scenes import icosphere, looking_at

SIZE = 32
FACTORS = np.array([1.0, 1.3, 0.8, 1.1, 0.7, 1.25])


def photographs(factors: np.ndarray) -> tuple[Capture, Scene]:
    """A grey ball under a smooth light from six sides; each photograph is multiplied by its factor."""
    light = 0.5 + 0.4 * texel_directions(16, 32)[:, 1:2]
    sky = EnvironmentMap((light * torch.tensor([0.9, 0.8, 0.7])).reshape(16, 32, 3).float())
    grey = Material("paper", torch.full((3,), 0.5), torch.zeros(3), torch.ones(1))
    scene = Scene(icosphere(3), grey, sky)
    eyes = [(4 * np.sin(a), 1.0, 4 * np.cos(a)) for a in np.linspace(0, 2 * np.pi, 6, endpoint=False)]
    nothing = np.zeros((SIZE, SIZE), bool)
    empty = Pixels(np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), nothing)
    cameras = [looking_at(eye, SIZE, SIZE) for eye in eyes]
    blank = Capture(Path("made"), tuple(View(str(i), c, lambda: empty) for i, c in enumerate(cameras)))
    prepared = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800)).prepare(scene, blank)
    grid = torch.tensor([(v, x, y) for v in range(6) for y in range(SIZE) for x in range(SIZE)])
    shown = prepared.radiance(grey, sky, grid).reshape(6, SIZE, SIZE, 3).numpy()
    views = []
    for i, (camera, factor) in enumerate(zip(cameras, factors, strict=True)):
        color = (shown[i] * factor).astype(np.float32)
        pixels = Pixels(color, (color.sum(axis=2) > 0).astype(np.float32), nothing)
        views.append(View(str(i), camera, lambda pixels=pixels: pixels))  # type: ignore[misc]
    start = replace(scene, environment=EnvironmentMap(torch.full((16, 32, 3), 0.5)))
    return Capture(Path("made"), tuple(views)), start


@pytest.mark.slow
def test_drifting_exposures_are_found_and_cost_nothing() -> None:
    capture, scene = photographs(FACTORS)
    errors = {}
    for gain in (False, True):
        options = TransportGGXOptions(vertices=0, cache_cells=800, steps=150, view_gain=gain)
        solver = TransportGGX(options).prepare(scene, capture)
        fit = solver.fit(ModelSpec(), None, range(6), 1.0, lambda _: None)  # type: ignore[attr-defined]
        errors[gain] = solver.errors(fit, range(6)).mean()  # type: ignore[attr-defined]
        if gain:
            found = fit.parameters.exposure.numpy()
            true = FACTORS / np.exp(np.log(FACTORS).mean())
            np.testing.assert_allclose(found, true, rtol=0.03)
    assert errors[True] < 0.05 * errors[False]


def test_a_held_out_photograph_is_compared_at_its_own_exposure() -> None:
    capture, scene = photographs(FACTORS)
    options = TransportGGXOptions(vertices=0, cache_cells=800, steps=150, view_gain=True)
    solver = TransportGGX(options).prepare(scene, capture)
    fit = solver.fit(ModelSpec(), None, range(5), 1.0, lambda _: None)  # type: ignore[attr-defined]
    found = -10 * np.log10(solver.errors(fit, [5])[0])  # type: ignore[attr-defined]
    as_others = replace(fit, parameters=replace(fit.parameters, log_exposure=None))
    # the remaining error is at the rim, which no other photograph shows
    assert found > 28 and found > 6 - 10 * np.log10(solver.errors(as_others, [5])[0])  # type: ignore[attr-defined]
