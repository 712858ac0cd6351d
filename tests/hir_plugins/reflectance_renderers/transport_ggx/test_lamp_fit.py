"""Fits of photographs under a lamp near the camera and a light that stands still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Capture
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import CameraLamp, EnvironmentMap, Scene
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.made_captures import around, ball, fitted, make_material, painted, photographs, sky, unseen_db

LAMP = CameraLamp(torch.tensor([12.0, 11.0, 9.0]), torch.tensor([0.3, -0.6, 0.0]), torch.tensor(2.0))
DIFFUSE, GLOSSY = ModelSpec(lamp=True), ModelSpec("dielectric", "uniform", lamp=True)


def truth() -> Scene:
    """A painted plastic ball in a dim room."""
    mesh = ball()
    color = painted(mesh, lambda p: 0.5 + 0.35 * torch.sin(p * torch.tensor([3.0, 4.0, 5.0]) + torch.arange(3)))[0]
    room = EnvironmentMap(0.3 * sky().radiance, lamp=LAMP)
    return Scene(mesh, make_material(color, 0.04, 0.15, "dielectric"), room)


def capture(scene: Scene, views: int) -> Capture:
    """From distances that differ by a factor of 1.8."""
    eyes = [tuple(0.8 * 1.8 ** (i * 0.754878 % 1) * np.array(eye)) for i, eye in enumerate(around(views))]
    return photographs(scene, eyes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def few() -> tuple[Scene, Capture]:
    scene = truth()
    return scene, capture(scene, 8)


@pytest.mark.slow
def test_the_scene_of_a_fit_shows_what_the_fit_predicts(few: tuple[Scene, Capture]) -> None:
    """Lengths of the fit are in another unit than the scene's; the lamp is part of the textures' equations."""
    scene, photographed = few
    start = replace(scene, environment=EnvironmentMap(torch.full((16, 32, 3), 0.5)))
    options = TransportGGXOptions(vertices=0, cache_cells=800, steps=60)
    solver = TransportGGX(options).prepare(start, photographed)
    views = range(8)
    fit = solver.fit(GLOSSY, None, views, 1.0, lambda share: None)
    solved = solver.scene(fit, views, lambda share: None)
    material, environment = solved.scene.material, solved.scene.environment
    assert material is not None and environment is not None and environment.lamp is not None
    for pixels, predicted in solver._predicted(fit, solver._pixels.compared(views)):
        order = torch.argsort(pixels.view, stable=True)
        predicted = predicted[order]
    at = solver._pixels.compared(views)
    shown = solved.prepared.radiance(material, environment, at.pixel)
    # the batches are in random order: means of views
    for view in views:
        mine, theirs = shown[at.pixel[:, 0] == view].mean(dim=0), predicted[pixels.view[order] == view].mean(dim=0)
        torch.testing.assert_close(mine, theirs, rtol=0.03, atol=0.0)
    dark = solved.prepared.radiance(material, replace(environment, lamp=None), at.pixel)
    assert float(dark.mean()) < 0.9 * float(shown.mean())


def test_a_fit_that_goes_on_keeps_its_lamp(few: tuple[Scene, Capture]) -> None:
    scene, photographed = few
    start = replace(scene, environment=EnvironmentMap(torch.full((16, 32, 3), 0.5)))
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=200, steps=10)).prepare(start, photographed)
    first = solver.fit(DIFFUSE, None, range(8), 1.0, lambda share: None)
    lamp = first.parameters.lamp
    assert lamp is not None
    same = solver.fit(DIFFUSE, first, range(8), 0.0, lambda share: None).parameters.lamp
    assert same is not None and torch.equal(same, lamp)
    glossy = solver.fit(GLOSSY, first, range(8), 0.1, lambda share: None).parameters.lamp
    assert glossy is not None and 0 < float((glossy - lamp).abs().max()) < 0.3
    without = solver.fit(ModelSpec(), first, range(8), 0.1, lambda share: None)
    assert without.parameters.lamp is None and solver.supported(replace(GLOSSY, per_texel="brdf")) == GLOSSY


@pytest.mark.slow
def test_a_lamp_is_found_and_selected(tmp_path: Path) -> None:
    """Place of the lamp, its colour together with the albedo's, and views from other distances, beside other light.

    Photographs show the product of both colours; the prior of white light divides it between them.
    """
    scene = truth()
    found, report = fitted(
        scene.mesh, capture(scene, 24), tmp_path, light_frame="auto", path_tracing={"refine_albedo": False}
    )
    assert report.light_frame == "lamp" and report.explanation is not None
    assert "lamp near the camera" in report.explanation.chosen
    assert found.environment is not None and found.environment.lamp is not None
    lamp = found.environment.lamp
    np.testing.assert_allclose(lamp.offset[:2], LAMP.offset[:2], atol=0.1)
    colors = []
    for each, owner in ((lamp, found), (LAMP, scene)):
        assert owner.material is not None
        reflected = each.intensity * owner.material.diffuse_albedo.reshape(-1, 3).mean(dim=0)
        colors.append(reflected / reflected.mean())
    np.testing.assert_allclose(colors[0], colors[1], atol=0.06)
    assert unseen_db(found, scene) > 40 and unseen_db(found, scene, (4.4, 2.3, 4.9)) > 36


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.0, 0.8])
def test_the_size_of_a_lamp_is_found(radius: float) -> None:
    """From the highlights of a glossy ball, which a disc makes as wide as it is."""
    scene = truth()
    assert scene.environment is not None
    lamp = replace(LAMP, radius=torch.tensor(radius))
    photographed = capture(replace(scene, environment=replace(scene.environment, lamp=lamp)), 16)
    start = replace(scene, environment=EnvironmentMap(torch.full((16, 32, 3), 0.5)))
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=400)).prepare(start, photographed)
    fit = solver.fit(GLOSSY, None, range(16), 1.0, lambda share: None)
    found = solver.scene(fit, range(16), lambda share: None).scene
    assert found.environment is not None and found.environment.lamp is not None
    size = float(found.environment.lamp.radius)
    assert size < 0.25 if radius == 0 else 0.4 < size < 1.2, "one fit of 200 steps does not go all the way"
