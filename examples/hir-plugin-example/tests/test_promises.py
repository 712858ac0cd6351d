"""Properties of the components beyond the contracts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import srgb_to_linear

from hir_core.plugins.manager import PluginManager
from hir_core.testing.assets import textured_asset


@pytest.fixture(scope="module")
def plugins() -> PluginManager:
    return PluginManager.discover()


def test_found_by_installation(plugins: PluginManager) -> None:
    ours = [r.component.name for r in plugins.components() if r.distribution == "hir-plugin-example"]
    assert ours == ["midpoint_outline", "supersampled", "light_chroma", "ply"]


def test_the_brightness_of_a_light_does_not_change_its_chroma(plugins: PluginManager) -> None:
    from dataclasses import replace

    from hir_core.testing.scenes import bumpy_scene

    scene = bumpy_scene()
    assert scene.environment is not None
    energy = plugins.create("regularizer", "light_chroma", {"floor": 0.0}).prepare(scene)
    brighter = replace(scene, environment=replace(scene.environment, radiance=7 * scene.environment.radiance))
    assert float(energy(brighter)) == pytest.approx(float(energy(scene)), rel=1e-5)


def test_ply_has_the_colour_of_the_texture(plugins: PluginManager, tmp_path: Path) -> None:
    from dataclasses import replace

    import trimesh

    asset, width = textured_asset(), 16
    # a linear ramp is also exact between texel centres
    ramp = np.broadcast_to((np.arange(width, dtype=np.float32)[None, :, None] + 0.5) / width, (width, width, 3))
    asset = replace(asset, material=replace(asset.material, diffuse_albedo=ramp))
    plugins.create("exporter", "ply").write(asset, tmp_path / "ball.ply")
    mesh = trimesh.load(tmp_path / "ball.ply", process=False)
    found = srgb_to_linear(np.asarray(mesh.visual.vertex_colors)[:, :3] / 255)
    expected = np.clip(asset.mesh.uvs[:, :1], 0.5 / width, 1 - 0.5 / width)
    assert np.abs(found - expected).max() < 0.006, "half a step of 8-bit sRGB"


def test_gradient_finds_the_sphere_that_fits_a_mask(plugins: PluginManager) -> None:
    """A few steps of descent through midpoint_outline grow a sphere to its mask."""
    import torch

    from hir_core.capture import View
    from hir_core.testing.captures import StoredPixels
    from hir_core.testing.scenes import looking_at, smooth_sphere

    camera, ball = looking_at((0, 0, 4), 64), smooth_sphere(2)
    renderer = plugins.create("geometry_renderer", "midpoint_outline")
    mask = renderer.render(ball, [camera])[0].numpy().astype(np.float32)
    targets = renderer.prepare([View("0", camera, StoredPixels(np.zeros((64, 64, 3), np.float32), mask))])
    scale = torch.tensor(0.7, requires_grad=True)
    for step in range(40):
        area, overlap = renderer.overlap(ball.with_positions(scale * ball.positions), targets)
        union = area + float(mask.sum()) - overlap
        (slope,) = torch.autograd.grad((1 - overlap / union).sum(), scale)
        with torch.no_grad():
            scale -= 0.08 * 0.9**step * slope
    assert float(scale.detach()) == pytest.approx(1.0, abs=0.03)
