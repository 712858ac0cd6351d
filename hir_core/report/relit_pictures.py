"""The asset under another light, beside the same mesh with the photographs' colours as its texture.

A texture from photographs contains the light in which they were taken. Under another light its shadows stay where they
were; those of a fitted material move with the light.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hir_core.metrics import Image, composite, unassociate
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.scene_store import load_stage_scene

if TYPE_CHECKING:
    from hir_core.capture import Camera
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.finished_run import FinishedRun

TURN_DEGREES = 120.0
"""The light of the fit is turned by this about the vertical."""
SIDE = 512
"""Longest side of the pictures, at most."""
SAMPLES = 128
TEXTURE_ONLY_F0, TEXTURE_ONLY_ALPHA = 0.04, 0.25
"""What a texture without other maps is usually given: a dielectric of roughness 0.5, which is α = 0.25."""

BEFORE, AFTER = "relit_texture", "relit_material"


def relit_pictures(run: FinishedRun, camera: Camera, plugins: PluginManager) -> dict[str, Image]:
    """Both as sRGB pictures by file name; empty where the run has no texture from photographs on the same mesh.

    The texture's brightness has one factor: its scale belongs to the old light.
    """
    import torch

    record = run.directory.record("atlas")
    if record is None or not record.finished or run.scene.environment is None:
        return {}
    texture = load_stage_scene(run.directory.stage("atlas") / "scene", "cpu")
    if texture.material is None or texture.mesh.uvs is None or texture.mesh.vertex_colors is None:
        return {}  # without colours at the vertices the atlas is grey
    plain = Material(
        "dielectric",
        texture.material.diffuse_albedo.clamp(0, 1),
        torch.full((3,), TEXTURE_ONLY_F0),
        torch.full((1,), TEXTURE_ONLY_ALPHA),
    )
    light = turned(run.scene.environment, TURN_DEGREES)
    small = camera.downsampled(max(1, math.ceil(max(camera.width, camera.height) / SIDE)))
    _, renderer = reference_renderer(plugins, bounces=run.bounces, max_samples=SAMPLES)
    after = render_view(renderer, replace(run.scene, environment=light), small, AFTER)
    before = render_view(renderer, Scene(texture.mesh, plain, light), small, BEFORE)
    sums = [float(np.clip(image[..., :3], 0, 1).sum(dtype=np.float64)) for image in (after, before)]
    before[..., :3] *= sums[0] / sums[1] if sums[1] > 0 else 1.0
    return {name: composite(*unassociate(image)) for name, image in ((BEFORE, before), (AFTER, after))}


def turned(light: EnvironmentMap, degrees: float) -> EnvironmentMap:
    """The light turned about the vertical, of the camera where it carries the light."""
    import torch

    angle = math.radians(degrees)
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).to(light.radiance)
    return replace(light, to_world=turn if light.to_world is None else turn @ light.to_world)
