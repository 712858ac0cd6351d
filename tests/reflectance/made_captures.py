"""Made captures: path-traced photographs of a scene that is known, the fit of them, and how near it comes.

The path tracer shares no code with the cached transport that is fitted, but the BRDF.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hir_exporters.textures.image_files import write_hdr
from torch import Tensor

from hir_core.capture import Capture, Pixels, View
from hir_core.config import ReflectanceSettings
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_core.stages.atlas import TexelSurface, dilate, texel_surface, unwrap_mesh
from hir_core.stages.reflectance.reflectance_fit import fit_reflectance
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions

from .shapes import icosphere, looking_at

Eye = tuple[float, float, float]
Report = dict[str, Any]

SIZE, ROWS, TEXELS = 32, 16, 64
PLUGINS = PluginManager.discover()
BROWN = (0.5, 0.3, 0.2)


def around(count: int, highest: float = 0.7) -> list[Eye]:
    """Eyes on a spiral about the origin, from `highest` below it to as far above."""
    heights = 2 * highest * ((np.arange(count) + 0.5) / count - 0.5)
    angles = 2 * np.pi * 0.618034 * np.arange(count)
    rings = np.sqrt(1 - heights**2)
    return [(4 * r * np.sin(a), 4 * y, 4 * r * np.cos(a)) for a, y, r in zip(angles, heights, rings, strict=True)]


def above(count: int, widest: float) -> list[Eye]:
    """Eyes on a spiral about +y, at most `widest` radians from it."""
    tilts, turns = np.linspace(0.05, widest, count), 2 * np.pi * 0.618034 * np.arange(count)
    return [
        (4 * np.sin(t) * np.sin(a), 4 * np.cos(t), 4 * np.sin(t) * np.cos(a)) for t, a in zip(tilts, turns, strict=True)
    ]


def sky(rows: int = ROWS) -> EnvironmentMap:
    """Light from above, with a little to tell the sides apart."""
    d = texel_directions(rows, 2 * rows)
    value = 0.5 + 0.4 * d[:, 1:2] + 0.2 * torch.sin(3 * d[:, :1])
    return EnvironmentMap(value.clamp_min(0.02).expand(-1, 3).reshape(rows, 2 * rows, 3).contiguous())


def lamps(rows: int = ROWS) -> EnvironmentMap:
    """Four soft lamps of different sizes, which a lobe shows each in its own way."""
    d = texel_directions(rows, 2 * rows)
    value = torch.full((len(d), 1), 0.15)
    for place, narrow, strength in (
        ((1.0, 1.0, 0.3), 20, 2.5),
        ((-1.0, 0.3, 0.6), 40, 2.0),
        ((0.0, 0.8, -1.0), 60, 3.0),
        ((0.3, -0.6, 1.0), 10, 0.5),
    ):
        middle = torch.nn.functional.normalize(torch.tensor(place), dim=0)
        value = value + strength * torch.exp(narrow * (d @ middle - 1))[:, None]
    return EnvironmentMap(value.expand(-1, 3).reshape(rows, 2 * rows, 3).contiguous())


def look(
    diffuse: Sequence[float] | Tensor,
    specular: float | Sequence[float] | Tensor = 0.0,
    alpha: float | Tensor = 0.3,
    model: str = "paper",
) -> Material:
    rho_s = torch.as_tensor(specular, dtype=torch.float32)
    rho_s = rho_s.expand(3) if rho_s.ndim == 0 else rho_s
    width = torch.as_tensor(alpha, dtype=torch.float32)
    return Material(
        model,
        torch.as_tensor(diffuse, dtype=torch.float32),
        rho_s.contiguous(),
        width.reshape(1) if width.ndim == 0 else width,
    )  # type: ignore[arg-type]


def ball(texels: int = TEXELS) -> Mesh:
    return unwrap_mesh(icosphere(3), texels)[0]


def bowl() -> Mesh:
    """As deep as it is wide, open at the top; inside and outside are walls of their own."""
    import trimesh

    bend = np.linspace(0.05, np.pi / 2, 8)
    outside = [(0.95 * np.sin(t), -np.cos(t)) for t in bend]
    inside = [(0.85 * np.sin(t), -0.9 * np.cos(t)) for t in bend[::-1]]
    profile = [(0.0, -1.0), *outside, (0.95, 0.6), (0.85, 0.6), *inside, (0.0, -0.9)]
    made = trimesh.creation.revolve(np.array(profile), sections=32)
    if made.volume < 0:
        made.invert()
    faces = torch.from_numpy(np.asarray(made.faces, dtype=np.int64))
    upright = np.asarray(made.vertices, dtype=np.float32)[:, [1, 2, 0]]
    return Mesh(torch.from_numpy(upright.copy()), Topology(faces))


def painted(mesh: Mesh, color: Callable[[Tensor], Tensor], texels: int = TEXELS) -> tuple[Tensor, TexelSurface]:
    """A texture whose texels have the colour of their place."""
    surface = texel_surface(mesh, texels)
    values = color(surface.position)
    texture = torch.zeros(texels, texels, values.shape[1])
    texture[surface.covered] = values
    return dilate(texture, surface.covered, 8), surface


def traced(scene: Scene, eyes: Sequence[Eye], depth: int = 2, size: int = SIZE, paths: int = 256) -> np.ndarray:
    """Linear radiance (views, size, size, 3)."""
    assert scene.material is not None and scene.environment is not None
    blank = Pixels(np.zeros((size, size, 3), np.float32), None, np.zeros((size, size), bool))
    views = tuple(View(str(i), looking_at(eye, size, size), lambda: blank) for i, eye in enumerate(eyes))
    tracer = MitsubaGGX(MitsubaGGXOptions(samples=paths, max_depth=depth)).prepare(scene, Capture(Path("made"), views))
    grid = torch.tensor([(v, x, y) for v in range(len(eyes)) for y in range(size) for x in range(size)])
    torch.manual_seed(0)
    with torch.no_grad():
        radiance: np.ndarray = tracer.radiance(scene.material, scene.environment, grid).numpy()
    return radiance.reshape(len(eyes), size, size, 3)


def photographs(
    scene: Scene, eyes: Sequence[Eye], depth: int = 2, size: int = SIZE, exposures: Sequence[float] | None = None
) -> Capture:
    """Photographs of the scene, clipped at 1 as a sensor clips them; black is no part of the object."""
    radiance = traced(scene, eyes, depth, size)
    covered = coverage(scene.mesh, eyes, size)
    views = []
    for i, (eye, exposure) in enumerate(zip(eyes, exposures or [1.0] * len(eyes), strict=True)):
        color = radiance[i] * exposure
        pixels = Pixels(np.minimum(color, 1).astype(np.float32), covered[i], (color >= 1).any(axis=2))
        views.append(View(str(i), looking_at(eye, size, size), lambda p=pixels: p, exposure=exposure))  # type: ignore[misc]
    return Capture(Path("made"), tuple(views))


def coverage(mesh: Mesh, eyes: Sequence[Eye], size: int = SIZE) -> np.ndarray:
    """Which pixels (views, size, size) see the mesh, black as it may be."""
    white = EnvironmentMap(torch.ones(ROWS, 2 * ROWS, 3))
    seen = traced(Scene(mesh, look((1.0, 1.0, 1.0)), white), eyes, 2, size, 8).sum(axis=3)
    return (seen > 0).astype(np.float32)


def fitted(
    mesh: Mesh,
    capture: Capture,
    folder: Path,
    texels: int = TEXELS,
    light: EnvironmentMap | None = None,
    options: dict[str, Any] | None = None,
    **settings: Any,
) -> tuple[Scene, Report]:
    """The whole stage, from grey; `light`: the fit is told what shines. `report["said"]` holds its warnings."""
    grey = Scene(mesh, Material("paper", torch.full((texels, texels, 3), 0.5), torch.zeros(3), torch.ones(1)))
    given: dict[str, Any] = {"light_frame": "world", "environment_height": ROWS, "environment_width": 2 * ROWS}
    if light is not None:
        folder.mkdir(exist_ok=True)
        write_hdr(folder / "light.hdr", light.radiance.numpy())
        given["known_environment"] = str(folder / "light.hdr")
    said: list[str] = []
    transport = {"vertices": 0, "cells": 800, "steps": 200, **(options or {})}
    context = StageContext(PLUGINS, folder, {"reflectance_renderer": {"transport_ggx": transport}}, warn=said.append)
    scene, report = fit_reflectance(grey, capture, ReflectanceSettings(**(given | settings)), context)
    assert_sound(scene)
    return scene, {**report, "said": said}


def assert_sound(scene: Scene) -> None:
    """Finite, not negative, and no texel gives back more light than it gets."""
    material, environment = scene.material, scene.environment
    assert material is not None and environment is not None
    for value in (material.diffuse_albedo, material.specular_albedo, material.roughness, environment.radiance):
        assert bool(torch.isfinite(value).all()) and float(value.min()) >= 0
    assert float(material.roughness.max()) <= 1
    assert float(material.diffuse_albedo.max()) <= 1 and float(material.specular_albedo.max()) <= 1
    if material.model == "paper":
        assert float((material.diffuse_albedo + material.specular_albedo).max()) <= 1 + 1e-6


def observed(scene: Scene) -> tuple[Tensor, Tensor]:
    """Diffuse albedo (N, 3) of the texels that some view saw, and which (H, W) those are."""
    assert scene.material is not None and scene.material.observed is not None
    return scene.material.diffuse_albedo[scene.material.observed], scene.material.observed


def unseen_db(scene: Scene, truth: Scene, eye: Eye = (2.4, 1.3, 2.9), depth: int = 2) -> float:
    """PSNR of a path-traced picture of the fit, from a place no photograph was taken from."""
    seen = coverage(truth.mesh, [eye])[0] > 0
    found, true = (np.clip(traced(s, [eye], depth)[0][seen], 0, 1) for s in (scene, truth))
    return float(-10 * np.log10(np.square(found - true).mean()))
