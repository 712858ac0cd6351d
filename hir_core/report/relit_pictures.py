"""A surface with a texture from photographs, before, and the finished asset, after: beside a photograph, and relit.

The texture is the scan's own where the run began with a textured scan, otherwise the photographs' colours at the
vertices. Such a texture contains the light in which the photographs were taken. Under another light its shadows stay
where they were; those of a fitted material move with the light.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from hir_core.capture import block_mean
from hir_core.metrics import Image, composite, unassociate
from hir_core.rendering.converged_pair import SAMPLES, converged_pair
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.rendering.textured_scan import texture_as_material, textured_scan
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.scene import EnvironmentMap, Scene
from hir_core.scene.scene_store import load_stage_scene

if TYPE_CHECKING:
    from hir_core.capture import Camera
    from hir_core.plugins.interfaces import ReflectanceRenderer
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.photographs import MaskedPhotograph
    from hir_core.run.finished_run import FinishedRun

TURN_DEGREES = 120.0
"""The light of the fit is turned by this about the vertical."""
SIDE = 512
"""Longest side of the pictures, at most."""
SCAN, VERTICES = "scan", "vertices"
"""Where the texture is from: from the file of the scan, or from the photographs at the vertices."""
PHOTOGRAPH, FOUND, RELIT = "compared_photograph", "compared", "relit"
"""Beginnings of the names of pictures: beside a photograph, and under another light."""
MATERIAL = "material"

FILES: Final = (PHOTOGRAPH, *(f"{row}_{what}" for row in (FOUND, RELIT) for what in (SCAN, VERTICES, MATERIAL)))
"""Names of all pictures that there can be; a run has those of one texture."""


def relit_pictures(
    run: FinishedRun, camera: Camera, photograph: MaskedPhotograph, fit: Image, plugins: PluginManager
) -> dict[str, Image]:
    """sRGB pictures by file name; empty where the run has no texture from photographs.

    `fit` is the render (H, W, 4) of the finished asset in the view of the photograph. Each picture of the texture has
    one factor of brightness, because its scale belongs to the old light: to that of the photograph, and of the relit
    asset.
    """
    kind, textured = _textured(run)
    if textured is None or run.scene.environment is None:
        return {}
    factor = max(1, math.ceil(max(camera.width, camera.height) / SIDE))
    small, true = camera.downsampled(factor), photograph.downsampled(factor)
    target = true.color_linear * true.mask[..., None]
    light = turned(run.scene.environment, TURN_DEGREES)
    _, renderer = reference_renderer(plugins, bounces=run.bounces, max_samples=SAMPLES)
    after = _converged(renderer, run.with_light(light), small, f"{RELIT}_{MATERIAL}")
    lit = replace(textured, environment=light).to(light.radiance.device)
    before = _converged(renderer, lit, small, f"{RELIT}_{VERTICES}")
    unlit = UnlitRenderer(textured).render(small)
    return {
        PHOTOGRAPH: true.picture,
        f"{FOUND}_{kind}": _picture(_as_bright_as(unlit, target)),
        f"{FOUND}_{MATERIAL}": _picture(block_mean(fit, factor)),
        f"{RELIT}_{kind}": _picture(_as_bright_as(before, after[..., :3])),
        f"{RELIT}_{MATERIAL}": _picture(after),
    }


def _textured(run: FinishedRun) -> tuple[str, Scene | None]:
    """Where the texture is from, and the surface with it."""
    scan = textured_scan(run.directory.stage("initializer"))
    if scan is not None:
        return SCAN, scan
    record = run.directory.record("atlas")
    if record is None or not record.finished:
        return VERTICES, None
    atlas = load_stage_scene(run.directory.stage("atlas") / "scene", "cpu")
    if atlas.material is None or atlas.mesh.uvs is None or atlas.mesh.vertex_colors is None:
        return VERTICES, None  # without colours at the vertices the atlas is grey
    return VERTICES, Scene(atlas.mesh, texture_as_material(atlas.material.diffuse_albedo))


def _as_bright_as(image: Image, target: Image) -> Image:
    """A premultiplied render (H, W, 4) times one factor, so that it has the mean of linear colours (H, W, 3)."""
    wanted, own = (float(np.clip(colors, 0, 1).sum(dtype=np.float64)) for colors in (target, image[..., :3]))
    scaled = image.copy()
    scaled[..., :3] *= wanted / own if own > 0 else 1.0
    return scaled


def _converged(renderer: ReflectanceRenderer, scene: Scene, camera: Camera, label: str) -> Image:
    first, second = converged_pair(renderer, scene, camera, label)
    return (first + second) / np.float32(2)


def _picture(image: Image) -> Image:
    return composite(*unassociate(image))


def turned(light: EnvironmentMap, degrees: float) -> EnvironmentMap:
    """The light turned about the vertical, of the camera where it carries the light."""
    import torch

    angle = math.radians(degrees)
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).to(light.radiance)
    return replace(light, to_world=turn if light.to_world is None else turn @ light.to_world)
