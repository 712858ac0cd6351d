"""`transport_ggx` shades a `metallic` material."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Capture, Pixels, View
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.scenes import icosphere, looking_at

SIZE = 24
OPTIONS = TransportGGXOptions(vertices=0, cache_cells=3000, samples=64, render_samples=64)


def scene(m: float) -> Scene:
    """A gold-coloured ball of that metalness in a smooth light."""
    rows = torch.linspace(1.5, 0.2, 32)[:, None, None]
    made = Material.metallic(torch.tensor([0.9, 0.6, 0.2]), torch.tensor([m]), torch.tensor([0.3]))
    return Scene(icosphere(4), made, EnvironmentMap(rows * torch.tensor([1.0, 0.8, 0.6]).expand(32, 64, 3)))


def capture() -> Capture:
    shape = (SIZE, SIZE)
    blank = Pixels(np.zeros((*shape, 3), np.float32), np.ones(shape, np.float32), np.zeros(shape, bool))
    return Capture(Path("made"), (View("000", looking_at((0, 1, 4), SIZE, SIZE), lambda: blank),))


def pixels() -> torch.Tensor:
    return torch.tensor([(0, x, y) for y in range(SIZE) for x in range(SIZE)])


@pytest.mark.parametrize("m", [0.0, 0.5, 1.0])
def test_agrees_with_the_path_tracer(m: float) -> None:
    """Direct light on a ball against 1024 paths a pixel: mean difference below 1 %, mean absolute one below 3 %."""
    made = scene(m)
    assert made.material is not None and made.environment is not None
    shown = TransportGGX(OPTIONS).prepare(made, capture()).radiance(made.material, made.environment, pixels())
    torch.manual_seed(0)
    truth = MitsubaGGX(MitsubaGGXOptions(samples=1024, max_depth=2)).prepare(made, capture())
    reference = truth.radiance(made.material, made.environment, pixels())
    both = (reference.sum(1) > 0) & (shown.sum(1) > 0)
    assert int(both.sum()) > 150
    assert abs(float((shown - reference)[both].mean() / reference[both].mean())) < 0.01
    assert float((shown - reference)[both].abs().mean() / reference[both].mean()) < 0.03


def test_pictures_of_a_metal_are_tinted_by_its_base_colour() -> None:
    made = scene(1.0)
    image = TransportGGX(OPTIONS).render(made, looking_at((0, 1, 4), SIZE, SIZE))
    inside = image[image[..., 3] == 1]
    assert bool(torch.isfinite(image).all())
    # the light is (1, 0.8, 0.6); Schlick's term adds a little white to the base colour's ratios
    assert 0.63 < float(inside[:, 1].mean() / inside[:, 0].mean()) / 0.8 < 0.78
    assert 0.20 < float(inside[:, 2].mean() / inside[:, 0].mean()) / 0.6 < 0.40


def test_gradients_of_base_colour_and_metalness_are_finite_differences() -> None:
    made = scene(0.4)
    assert made.environment is not None
    light, prepared = made.environment, TransportGGX(OPTIONS).prepare(made, capture())
    base = torch.tensor([0.9, 0.6, 0.2], requires_grad=True)
    m = torch.tensor([0.4], requires_grad=True)

    def total(base: torch.Tensor, m: torch.Tensor) -> torch.Tensor:
        return prepared.radiance(Material.metallic(base, m, torch.tensor([0.3])), light, pixels()).double().sum()

    gradients = torch.autograd.grad(total(base, m), (base, m))
    step = 1e-2
    with torch.no_grad():
        up, down = (total(base + torch.tensor([s * step, 0, 0]), m) for s in (1, -1))
        torch.testing.assert_close(gradients[0][0].double(), (up - down) / (2 * step), rtol=1e-3, atol=0)
        up, down = (total(base, m + s * step) for s in (1, -1))
        torch.testing.assert_close(gradients[1][0].double(), (up - down) / (2 * step), rtol=1e-3, atol=0)


def test_metal_reflects_onto_metal() -> None:
    """Two metal balls against path tracing with one reflection, where it brings more than 15 %.

    Measured for a base colour of (.9, .7, .5): without indirect light the mean is 35 % too dark and single pixels
    are 35 % off (57 and 58 % for α = 0.1); with it 3 and 16 % (11 and 24 %). The energy is right, its direction is not.
    """
    made = scene(1.0)
    assert made.material is not None and made.environment is not None
    large, small = icosphere(4), icosphere(3, 0.45)
    positions = torch.cat([large.positions, small.positions + torch.tensor([0.3, 1.2, 0.9])])
    mesh = Mesh(positions, Topology(torch.cat([large.faces, small.faces + len(large.positions)])))
    material, light, seen = made.material, made.environment, pixels()
    solver = TransportGGX(OPTIONS).prepare(Scene(mesh, material, light), capture())
    base = material.base_color.expand(len(mesh.positions), 3)
    metal = Parameters(
        light.radiance.log(), torch.logit(base), torch.zeros(1, 1), None, metalness=torch.full((1, 1), torch.inf)
    )
    traced = []
    for depth in (2, 3):
        torch.manual_seed(0)
        tracer = MitsubaGGX(MitsubaGGXOptions(samples=256, max_depth=depth))
        traced.append(tracer.prepare(Scene(mesh, material, light), capture()).radiance(material, light, seen))
    direct = solver.radiance(material, light, seen)
    indirect = replace(solver._shading, indirect=solver._indirect_light(metal, 1)).radiance(material, light, seen)
    single, reference = traced
    rows = (direct.sum(1) > 0) & ((reference - single).sum(1) > 0.15 * reference.sum(1))
    assert int(rows.sum()) > 15

    def errors(shown: torch.Tensor) -> tuple[float, float]:
        difference, mean = (shown - reference)[rows], reference[rows].mean()
        return abs(float(difference.mean() / mean)), float(difference.abs().mean() / mean)

    bias, error = errors(indirect)
    assert bias < 0.1 and error < 0.25
    assert errors(direct)[0] > 2 * bias and errors(direct)[1] > 1.3 * error
