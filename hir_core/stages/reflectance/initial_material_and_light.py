"""The scene that a reflectance fit starts from: constant light and lobe, or the light that the settings name."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from hir_exporters.light.environment_map import resample_latlong, rotate_latlong
from hir_exporters.textures.image_files import read_hdr
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError, InputError, StageError
from hir_core.files.light_setting import parse_light_file
from hir_core.rendering.light_files import world_from_light
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.card_irradiance import measuring_views
from hir_core.stages.reflectance.selection.requested_model import default_spec, forced_spec

INITIAL_METALNESS = 0.5
"""Of gradient steps; neither metal nor dielectric."""
INITIAL_RADIANCE = 0.5
"""Of gradient steps."""
INITIAL_MEAN_ALBEDO = 0.3
"""What the mean colour of the photographs shows under the initial light. From a brighter start albedos reach 1 before
the brightest parts are as bright as in the photographs, and change less in a step (docs/studies/initial_guess.md)."""
SAMPLED_VIEWS = 16
"""Photographs whose mean colour is measured, evenly spaced."""


def initial_scene(scene: Scene, capture: Capture, settings: ReflectanceSettings, by_solver: bool = True) -> Scene:
    """The scene with a constant lobe and a constant light, as bright as a card measured it, or the known light.

    The diffuse albedo is the texture of the atlas stage, or constant where `reflectance.method` is `gradient`. Gradient
    steps get maps where the model has them; a solver makes its own.
    """
    if scene.material is None or scene.mesh.uvs is None:
        raise StageError("the reflectance stage needs texture coordinates and a base colour; run the atlas stage first")
    device = scene.mesh.positions.device
    spec = forced_spec(settings) or default_spec(settings)
    diffuse = scene.material.diffuse_albedo
    specular: Tensor = torch.full((3,), settings.initial_specular_albedo, device=device)
    roughness = torch.full((1,), settings.initial_roughness, device=device)
    if not by_solver:
        if spec.specular == "map" and diffuse.ndim == 3:
            specular = specular.expand(diffuse.shape[0], diffuse.shape[1], 3).contiguous()
        if spec.roughness == "map" and diffuse.ndim == 3:
            roughness = roughness.expand(diffuse.shape[0], diffuse.shape[1], 1).contiguous()
    if settings.method == "gradient":
        diffuse = torch.full_like(diffuse, settings.gradient.initial_diffuse_albedo)
    if spec.brdf == "metallic" and not by_solver:
        metalness = torch.ones(1, device=device)
        if spec.metalness == "map":
            size = (diffuse.shape[0], diffuse.shape[1], 1) if diffuse.ndim == 3 else (1,)
            metalness = torch.full(size, INITIAL_METALNESS, device=device)
        material = Material.metallic(diffuse, metalness, roughness, dielectric_f0=settings.initial_specular_albedo)
    else:
        model = spec.brdf if spec.brdf in ("paper", "dielectric") else "dielectric"
        material = Material(model, diffuse, specular, roughness)
    rows = (settings.environment_height, settings.environment_width)
    if settings.known_environment:
        environment = known_light(settings.known_environment, capture, rows, str(device))
    else:
        radiance = torch.full((*rows, 3), initial_radiance(capture, settings, by_solver), device=device)
        if capture.irradiance is not None and measuring_views(capture):
            # constant radiance L brings π·L to a card
            radiance = torch.tensor(capture.irradiance.mean, device=device).div(np.pi).expand(*rows, 3).contiguous()
        frame: Literal["world", "camera"] = "camera" if settings.light_frame == "camera" else "world"
        environment = EnvironmentMap(radiance, None, frame)
    return replace(scene, material=material, environment=environment)


def initial_radiance(capture: Capture, settings: ReflectanceSettings, by_solver: bool) -> float:
    """Radiance of a constant light: what the settings say, or what shows the photographs with the expected albedo.

    An object with albedo a that hides little of the light from itself has the colour a·L under radiance L.
    """
    if settings.initial_radiance != "auto":
        return settings.initial_radiance
    if not by_solver:
        return INITIAL_RADIANCE
    total, count = 0.0, 0.0
    views = len(capture.views)
    sampled = min(views, SAMPLED_VIEWS)
    for number in range(sampled):
        view = capture.views[(2 * number + 1) * views // (2 * sampled)]
        pixels = view.pixels(settings.downsample)
        color = pixels.color_linear.mean(axis=2) / view.gain.mean()
        inside = np.ones(color.shape) if pixels.mask is None else (pixels.mask > 0.5).astype(float)
        total += float((color * inside).sum())
        count += float(inside.sum())
    mean = total / count if count else 0.0
    return mean / INITIAL_MEAN_ALBEDO if mean > 0 else INITIAL_RADIANCE


def known_light(text: str, capture: Capture, size: tuple[int, int], device: str) -> EnvironmentMap:
    """The light in `FILE` or `FILE*STRENGTH`, rotated from the capture's axes to the world, resampled to `size`.

    Raises `ConfigError` where the strength is no number.
    """
    try:
        path, strength = parse_light_file(text)
    except InputError as error:
        raise ConfigError(f"reflectance.known_environment: {error}") from None
    radiance = read_hdr(path) * np.float32(strength)
    to_world = world_from_light(capture.world_from_source, capture.environment)
    rotated = resample_latlong(rotate_latlong(radiance, to_world), *size)
    return EnvironmentMap(torch.from_numpy(rotated.astype(np.float32)).to(device))
