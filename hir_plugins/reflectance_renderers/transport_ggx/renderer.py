"""`transport_ggx`: shading on cached light transport, for fixed geometry."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Camera, Capture
from hir_core.capture.capture_size import CaptureSize
from hir_core.errors import StageError
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.scene import Scene
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport, build_transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    ALPHA_LEVELS,
    PROBE_COLUMNS,
    PROBE_ROWS,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.take_lights import TakeLights
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import visible_points
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import MAX_CACHE_BYTES
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import OBSERVATIONS_PER_CHUNK
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import shade_points

LOBE_BYTES = 150
"""Of one direction of a pixel: four light texels with weights, its cosines, and its row of the matrices."""
HEMISPHERE_BYTES = 64
"""Of one direction of a pixel's hemisphere, where the light moves with the camera: four entries, twice."""
PIXEL_BYTES = 400
"""Of one pixel of a fit, without its lobe."""
EQUATION_BYTES = 340
"""Of one pixel that textures are solved from: its row, the row's transpose, and the vectors of the solver."""
PROBE_BYTES = ALPHA_LEVELS * PROBE_ROWS * PROBE_COLUMNS * 6
"""Of the radiance probe of one cell, twice: for torch and for Dr.Jit."""
OBSERVATION_BYTES = 16
"""Of one surface point in one photograph."""
PHOTOGRAPH_PIXEL_BYTES = 13
"""Of one pixel in the cache of photographs."""
RENDERED_CHUNK = 1 << 17
"""Rays that are shaded at a time."""


@final
class TransportGGX(ReflectanceRenderer):
    """Traces visibility once; light and material then enter by linear algebra (docs/reflectance.md)."""

    def __init__(self, config: TransportGGXOptions) -> None:
        self._options = config

    def memory(self, size: CaptureSize) -> int:
        """The irradiance cache, and the largest of the lobes of a fit, the equations of the textures, the per-texel
        BRDF.

        Includes the hemispheres of a light that moves with the camera, because model selection may try one.
        """
        options = self._options
        lobes = options.samples * LOBE_BYTES + options.diffuse_samples * HEMISPHERE_BYTES
        fitted = min(options.pixels, size.pixels)
        resident = min(fitted, max(options.resident_pixels, options.block_pixels))
        # a block is drawn at another width beside all others, and while its matrices are transposed they exist twice
        fit = (resident + 2 * min(resident, options.block_pixels)) * lobes + fitted * PIXEL_BYTES
        textures = min(options.texture_pixels, size.pixels) * EQUATION_BYTES
        per_texel = 2 * PROBE_BYTES * options.cache_cells * size.takes + 2 * OBSERVATION_BYTES * OBSERVATIONS_PER_CHUNK
        per_texel += min(MAX_CACHE_BYTES, PHOTOGRAPH_PIXEL_BYTES * size.pixels)
        return max(fit, textures, per_texel) + options.cache_cells * 4 * options.diffuse_rows**2 * 4

    def smaller(self) -> dict[str, int]:
        """Half the pixels of the fit, of its mini-batches and of the textures, down to an eighth of the default; then
        half the cells of the irradiance cache, down to a quarter.
        """
        options, default = self._options, TransportGGXOptions()
        if options.pixels // 2 >= default.pixels // 8:
            return {
                "pixels": options.pixels // 2,
                "block_pixels": max(1, options.block_pixels // 2),
                "texture_pixels": options.texture_pixels // 2,
            }
        return {"cache_cells": options.cache_cells // 2} if options.cache_cells // 2 >= default.cache_cells // 4 else {}

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> TransportSolver:
        """Caches transport for the scene's mesh and for lights of the size of the scene's light, one for each take."""
        transport = self._transport(scene)
        takes = TakeLights.of(capture, transport.surface.positions.device)
        return TransportSolver(replace(transport, takes=takes), scene, capture, downsample, self._options)

    def render(self, scene: Scene, camera: Camera) -> Float[Tensor, "H W 4"]:
        """Direct light with visibility; premultiplied colour and coverage of `supersampling`² rays a pixel."""
        if scene.material is None or scene.environment is None:
            raise StageError("the scene has no material or no light yet; run the reflectance stage first")
        transport = self._transport(scene)
        side = self._options.supersampling
        fine = camera.downsampled(1)
        scaled = torch.tensor([side, side, 1.0], dtype=torch.float64).diag().numpy() @ fine.intrinsics
        fine = Camera(scaled, camera.world_to_camera, camera.width * side, camera.height * side)
        y, x = torch.meshgrid(torch.arange(fine.height), torch.arange(fine.width), indexing="ij")
        pixels = torch.stack([torch.zeros_like(x), x, y], dim=-1).reshape(-1, 3)
        points, found = visible_points(transport.tracer, transport.surface, {0: fine}, pixels)
        seen = found.nonzero()[:, 0]
        options = TransportGGXOptions(**{**self._options.__dict__, "samples": self._options.render_samples})
        image = torch.zeros(len(pixels), 4, device=scene.mesh.positions.device)
        for part in seen.split(RENDERED_CHUNK):
            color = shade_points(transport, scene.material, scene.environment, {0: camera}, points.take(part), options)
            image[part, :3] = color.to(image)
            image[part, 3] = 1
        return image.reshape(camera.height, side, camera.width, side, 4).mean(dim=(1, 3))

    def _transport(self, scene: Scene) -> Transport:
        if scene.environment is None:
            raise StageError("the scene has no light; give it an environment map")
        height, width = scene.environment.radiance.shape[:2]
        options = self._options
        device = str(scene.mesh.positions.device)
        size = (height, width)
        return build_transport(scene.mesh, options.vertices, options.cache_cells, size, options.diffuse_rows, device)
