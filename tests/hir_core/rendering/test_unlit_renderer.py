"""A surface without light is the same surface in a white furnace: under even light a convex diffuse body shows ρd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from hir_exporters.textures.bilinear import sample_bilinear

from hir_core.plugins.manager import PluginManager
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.testing.scenes import looking_at, sphere

SIZE = 48


def textured() -> Scene:
    """A ball whose albedo varies over tens of texels, so that filters do not matter."""
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(64) + 0.5) / 64, indexing="ij")
    albedo = np.stack([0.5 + 0.4 * np.sin(2 * np.pi * u), 0.2 + 0.6 * v, np.full_like(u, 0.3)], -1).astype(np.float32)
    material = Material("paper", torch.from_numpy(albedo), torch.zeros(3), torch.ones(1))
    return Scene(sphere(24, 36), material, EnvironmentMap(torch.ones(8, 16, 3)))


def test_unlit_is_what_a_white_furnace_shows() -> None:
    scene, camera = textured(), looking_at((1.0, 1.5, 3.0), SIZE)
    ours = UnlitRenderer(scene).render(camera)
    _, renderer = reference_renderer(PluginManager.discover(), "", {"render_samples": 256, "max_depth": 2})
    theirs = render_view(renderer, scene, camera, "furnace")
    inside = (ours[..., 3] == 1) & (theirs[..., 3] > 0.999)
    assert inside.mean() > 0.2
    # a path sees the light or does not where the facets' horizon is; the mean over pixels has no such noise
    assert np.abs(ours[inside] - theirs[inside]).mean() < 0.01
    np.testing.assert_allclose(ours[inside].mean(axis=0), theirs[inside].mean(axis=0), rtol=0.01)
    assert abs(float((ours[..., 3] - theirs[..., 3]).mean())) < 0.002, "as large"


def test_vertex_colours_are_interpolated() -> None:
    scene = textured()
    positions = scene.mesh.positions
    mesh = replace(scene.mesh, vertex_colors=positions * 0.4 + 0.5)
    camera = looking_at((0.0, 0.0, 3.0), SIZE)
    picture = UnlitRenderer(Scene(mesh)).render(camera)
    rows, columns = np.nonzero(picture[..., 3] == 1)
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
    origins, directions = camera.rays(pixels)
    # the unit sphere: o + t d with |o + t d| = 1
    b = (origins * directions).sum(axis=1)
    t = -b - np.sqrt(np.maximum(b**2 - (origins**2).sum(axis=1) + 1, 0))
    expected = (origins + t[:, None] * directions) * 0.4 + 0.5
    flat = np.abs(directions[:, :2]).max(axis=1) < 0.15  # away from the outline, where a pixel spans much of the ball
    np.testing.assert_allclose(picture[rows, columns, :3][flat], expected[flat], atol=0.02)


def test_a_scene_without_colours_is_grey() -> None:
    scene = replace(textured(), material=None)
    picture = UnlitRenderer(scene).render(looking_at((0.0, 0.0, 3.0), SIZE))
    np.testing.assert_allclose(picture[..., :3], 0.5 * picture[..., 3:].repeat(3, axis=2), atol=1e-6)


def test_samples_are_bilinear_between_texel_centres() -> None:
    texture = np.arange(8, dtype=np.float32).reshape(2, 4, 1)
    uv = np.array([[0.5 / 4, 0.25], [1.0 / 4, 0.25], [0.5 / 4, 0.5], [0.0, 0.0], [1.0, 1.0]])
    values = sample_bilinear(texture, uv[:, 0] * 4 - 0.5, uv[:, 1] * 2 - 0.5)
    np.testing.assert_allclose(values[:, 0], [0, 0.5, 2, 0, 7], atol=1e-6)
