"""What the components promise beyond the contracts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import srgb_to_linear

from hir_core.manager import PluginManager
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
    import trimesh

    asset = textured_asset()
    plugins.create("exporter", "ply").write(asset, tmp_path / "ball.ply")
    mesh = trimesh.load(tmp_path / "ball.ply", process=False)
    found = srgb_to_linear(np.asarray(mesh.visual.vertex_colors)[:, :3] / 255)
    x = np.clip((asset.mesh.uvs[:, 0] * 16).astype(int), 0, 15)
    y = np.clip((asset.mesh.uvs[:, 1] * 16).astype(int), 0, 15)
    nearest = asset.material.diffuse_albedo[y, x]
    assert np.abs(found - nearest).mean() < 0.03, "a texel's colour, but for what lies between two"


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
    for _ in range(30):
        area, overlap = renderer.overlap(ball.with_positions(scale * ball.positions), targets)
        union = area + float(mask.sum()) - overlap
        (slope,) = torch.autograd.grad((1 - overlap / union).sum(), scale)
        with torch.no_grad():
            scale -= 0.05 * slope
    assert float(scale) == pytest.approx(1.0, abs=0.03)
