"""How well a surface explains photographs where material and light are known: its pixels are path-traced.

A lid over a hollow has another radiance than the inside: the walls of a metal vessel reflect each other, those of a
dark one shade each other. The surface is rendered with one material all over, so that a lid cannot hide in its texture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_plugins.initializers.hollows.photo_prediction import BlurredPhotograph, Pixels, blurred_colors
from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_mesh import Surface
from hir_plugins.reflectance_renderers.mitsuba_ggx.prepared_scene import PreparedMitsuba
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on

DEPTH = 8
"""Mitsuba's count of a path's surfaces and its light: a silver vase shows five reflections inside."""

Floats = NDArray[np.floating]
Triangles = tuple[Floats, NDArray[np.integer]]
"""Vertices (V, 3) and faces (F, 3)."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """A fitted scene, whose light and mean material other surfaces are given."""

    fitted: Scene
    material: Material
    """The median of each map over observed texels."""
    lights: Sequence[EnvironmentMap]
    """By the number of the take."""

    @classmethod
    def of(cls, scene: Scene, takes: Sequence[str]) -> Appearance:
        """That of a scene with material and light."""
        material = scene.material
        assert material is not None and scene.environment is not None
        lights = [scene.in_take(take).environment for take in takes]
        return cls(scene, _median_material(material), [light for light in lights if light is not None])

    def radiance(
        self,
        surface: Triangles,
        photographs: Sequence[BlurredPhotograph],
        pixels: Mapping[int, Pixels],
        samples: int,
        seed: int,
    ) -> dict[int, Array]:
        """Linear colours (N, 3) of the pixels of the photographs with these indices, of so many paths each; 0 where a
        pixel shows nothing of the surface.
        """
        mesh = Mesh(
            torch.from_numpy(np.asarray(surface[0], np.float32)),
            Topology(torch.from_numpy(np.asarray(surface[1], np.int32))),
        )
        scene = Scene(mesh, self.material).to(self.lights[0].radiance.device)
        return self._radiance(scene, photographs, pixels, samples, seed)

    def fitted_pictures(
        self, photographs: Sequence[BlurredPhotograph], samples: int, seed: int
    ) -> list[NDArray[np.float32]]:
        """The fitted mesh with all its maps as each photograph shows it (H, W, 3), blurred like that."""
        pixels = {i: np.argwhere(each.valid)[:, ::-1] for i, each in enumerate(photographs) if each.valid.any()}
        radiance = self._radiance(self.fitted, photographs, pixels, samples, seed)
        pictures = []
        for i, photograph in enumerate(photographs):
            linear = np.zeros((*photograph.valid.shape, 3))
            if i in pixels:
                linear[pixels[i][:, 1], pixels[i][:, 0]] = radiance[i] * photograph.gain
            pictures.append(blurred_colors(linear, photograph.valid, photograph.sigma))
        return pictures

    def _radiance(
        self,
        scene: Scene,
        photographs: Sequence[BlurredPhotograph],
        pixels: Mapping[int, Pixels],
        samples: int,
        seed: int,
    ) -> dict[int, Array]:
        assert scene.material is not None
        device = str(scene.mesh.positions.device)
        mitsuba_on(device)
        cameras = [photograph.camera for photograph in photographs]
        prepared = PreparedMitsuba(Surface(scene.mesh), cameras, samples, 0, DEPTH, lambda: mitsuba_on(device))
        found: dict[int, Array] = {}
        for take, light in enumerate(self.lights):
            own = {i: chosen for i, chosen in pixels.items() if photographs[i].take == take}
            if not own:
                continue
            rows = np.concatenate([np.insert(chosen, 0, i, axis=1) for i, chosen in own.items()])
            traced = prepared.trace(scene.material, light, torch.from_numpy(rows).int().to(device), samples, seed)
            ends = np.cumsum([len(chosen) for chosen in own.values()])[:-1]
            colors = traced.color.cpu().numpy().astype(np.float64)
            found |= dict(zip(own, np.split(colors, ends), strict=True))
        return {i: found[i] for i in pixels}


def squared_errors(
    radiance: Mapping[int, Array],
    photographs: Sequence[BlurredPhotograph],
    pixels: Mapping[int, Pixels],
    repainted: Mapping[int, NDArray[np.bool_]] | None = None,
) -> dict[int, Array]:
    """Squared errors of the pixels, encoded as sRGB and summed over channels.

    With `repainted` (N,) for each photograph, those pixels and the others may each have another colour: the radiance is
    multiplied by a factor for each channel, the one with the least squared error of linear values.
    """
    photographed = {i: photographs[i].colors[chosen[:, 1], chosen[:, 0]] for i, chosen in pixels.items()}
    linear = {i: values * photographs[i].gain for i, values in radiance.items()}
    if repainted is not None:
        part = np.concatenate([repainted[i] for i in linear])
        rendered = np.concatenate(list(linear.values()))
        truth = srgb_to_linear(np.concatenate([photographed[i] for i in linear]).astype(np.float64))
        for chosen in (part, ~part):
            products, squares = (rendered * truth)[chosen].sum(axis=0), (rendered[chosen] ** 2).sum(axis=0)
            rendered[chosen] *= products / np.maximum(squares, 1e-12)
        ends = np.cumsum([len(values) for values in linear.values()])[:-1]
        linear = dict(zip(linear, np.split(rendered, ends), strict=True))
    return {
        i: ((linear_to_srgb(np.clip(values, 0, 1)) - photographed[i]) ** 2).sum(axis=1) for i, values in linear.items()
    }


def _median_material(material: Material) -> Material:
    def median(texture: torch.Tensor) -> torch.Tensor:
        if texture.ndim == 1:
            return texture
        chosen = texture.reshape(-1, texture.shape[-1])
        if material.observed is not None and material.observed.shape == texture.shape[:2] and material.observed.any():
            chosen = texture[material.observed]
        return chosen.median(dim=0).values

    roughness = median(material.roughness)
    if material.metalness is not None:
        base_color, metalness = median(material.base_color), median(material.metalness)
        return Material.metallic(base_color, metalness, roughness, dielectric_f0=material.dielectric_f0)
    return Material(material.model, median(material.diffuse_albedo), median(material.specular_albedo), roughness)
