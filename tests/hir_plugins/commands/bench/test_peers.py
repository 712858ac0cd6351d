"""Peers get the right input: stock Mitsuba the texture coordinates, open3d the colours of the photographs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.metrics import unassociate
from hir_core.rendering.orbit_cameras import orbit_cameras
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.scene import Material, Scene
from hir_core.testing.scenes import sphere
from hir_plugins.commands.bench.peers import color_map, stock_mitsuba
from hir_plugins.commands.bench.peers.projective import sensor

SIZE = 64


@pytest.fixture(scope="module")
def ball() -> Scene:
    """A sphere whose colour identifies the position on its texture."""
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(64) + 0.5) / 64, indexing="ij")
    albedo = np.stack([0.5 + 0.4 * np.sin(2 * np.pi * u), 0.1 + 0.7 * v, np.full_like(u, 0.3)], -1).astype(np.float32)
    return Scene(sphere(24, 36), Material("paper", torch.from_numpy(albedo), torch.zeros(3), torch.ones(1)))


def photographs(scene: Scene, cameras: list[Camera]) -> Capture:
    """Unlit views as a capture."""
    unlit = UnlitRenderer(scene)

    def view(i: int, camera: Camera) -> View:
        color, coverage = unassociate(unlit.render(camera))
        pixels = Pixels(color, coverage, np.zeros(coverage.shape, bool))
        return View(f"{i}", camera, lambda: pixels)

    return Capture(Path("made"), tuple(view(i, camera) for i, camera in enumerate(cameras)))


def test_stock_mitsuba_has_the_same_texture_coordinates(ball: Scene) -> None:
    mi = pytest.importorskip("mitsuba", reason="pip install 'hir[reconstruct]'")
    mi.set_variant("llvm_ad_rgb")
    stage = stock_mitsuba.textured_mi_scene(mi, ball, stock_mitsuba.TUNED)
    parameters = mi.traverse(stage)
    names = [key for key, _ in parameters]
    assert all(any(name.endswith(fitted) for name in names) for fitted in stock_mitsuba.FITTED_PARAMETERS)
    assert ball.material is not None
    side = stock_mitsuba.TEXTURE_SIDE // 64
    albedo = ball.material.diffuse_albedo.numpy().repeat(side, 0).repeat(side, 1)
    parameters["object.bsdf.base_color.data"] = mi.TensorXf(np.ascontiguousarray(albedo))
    parameters["object.bsdf.specular"] = 0.0
    parameters["object.bsdf.roughness.value"] = 1.0
    parameters.update()
    camera = orbit_cameras(8, 20.0, SIZE)[1]
    integrator = mi.load_dict({"type": "prb", "max_depth": 2, "hide_emitters": True})
    picture = np.array(mi.render(stage, sensor=mi.load_dict(sensor(mi, camera)), integrator=integrator, spp=64))
    ours = UnlitRenderer(ball).render(camera)
    inside = ours[..., 3] == 1
    for channel in (0, 1):
        # the third channel is one value everywhere: what varies in it is shading, which is not ours to compare
        theirs, own = (image[inside][:, channel] / image[inside][:, 2] for image in (picture, ours))
        np.testing.assert_allclose(theirs, own, atol=0.15 * own.max())
        assert np.corrcoef(theirs, own)[0, 1] > 0.99, "the same pattern at the same position"


def test_colour_mapping_reproduces_unseen_views_but_not_another_light(ball: Scene) -> None:
    pytest.importorskip("open3d", reason="pip install 'hir[reconstruct]'")
    ring = [*orbit_cameras(8, 25.0, SIZE), *orbit_cameras(8, -25.0, SIZE)]
    train, test = photographs(ball, ring), photographs(ball, orbit_cameras(5, 5.0, SIZE))
    colored = color_map.color_mapped(ball, train)
    assert color_map.mean_unlit_psnr(colored, test) > 30
    assert ball.material is not None
    darker = replace(ball, material=replace(ball.material, diffuse_albedo=ball.material.diffuse_albedo * 0.3))
    relit = photographs(darker, orbit_cameras(5, 5.0, SIZE))
    assert color_map.mean_unlit_psnr(colored, relit) < 15, "the baked light does not change"
