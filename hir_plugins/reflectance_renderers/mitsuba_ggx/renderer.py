"""The reflectance renderer `mitsuba_ggx`."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Camera, Capture
from hir_core.capture.capture_size import CaptureSize
from hir_core.errors import StageError
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.scene import Mesh, Scene
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on

if TYPE_CHECKING:
    from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_mesh import Surface
    from hir_plugins.reflectance_renderers.mitsuba_ggx.prepared_scene import PreparedMitsuba

_COVERAGE_SAMPLES = 16
"""Rays for each pixel that find the object's pixels before paths are traced."""


PATHS_BYTES = 256 << 20
"""Memory of one launch of `prepared_scene.LANES` paths."""


@final
class MitsubaGGX(ReflectanceRenderer):
    """Path tracing of the two BRDF models: unbiased values, and unbiased derivatives to material and light."""

    def __init__(self, config: MitsubaGGXOptions) -> None:
        self._config = config
        self._cached: tuple[Mesh, Surface] | None = None

    def memory(self, size: CaptureSize) -> int:
        """Colour and index of all pixels, and the paths of one launch."""
        return 40 * size.pixels + PATHS_BYTES

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedMitsuba:
        """Builds the acceleration structure for the cameras of a capture."""
        cameras = [camera.downsampled(downsample) for camera in capture.cameras]
        return self._prepare(scene, cameras)

    def render(self, scene: Scene, camera: Camera) -> Float[Tensor, "H W 4"]:
        """Linear premultiplied colour and coverage: mean radiance of the samples that hit the object, times their
        share.

        The seed of the noise comes from torch's generator.
        """
        if scene.material is None or scene.environment is None:
            raise StageError("a render needs a material and a light; let the reflectance stage run")
        prepared = self._prepare(scene, [camera])
        seed = int(torch.randint(0, 2**31 - 1, (1,)))
        samples = self._config.render_samples
        device = scene.mesh.positions.device
        pixels = _bounding_pixels(scene.mesh, camera).to(device)
        covered = prepared.coverage(pixels, min(samples, _COVERAGE_SAMPLES), seed) > 0
        pixels = _with_neighbours(pixels[covered], camera)
        image = torch.zeros(camera.height, camera.width, 4, device=device)
        traced = prepared.trace(scene.material, scene.environment, pixels, samples, seed)
        color = torch.cat([traced.color * traced.coverage[:, None], traced.coverage[:, None]], dim=1)
        image[pixels[:, 2], pixels[:, 1]] = color
        return image

    def _prepare(self, scene: Scene, cameras: list[Camera]) -> PreparedMitsuba:
        device = str(scene.mesh.positions.device)
        mitsuba_on(device)
        from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_mesh import Surface
        from hir_plugins.reflectance_renderers.mitsuba_ggx.prepared_scene import PreparedMitsuba

        # views of one scene are rendered in sequence, so the last acceleration structure is cached
        if self._cached is None or self._cached[0] is not scene.mesh:
            self._cached = (scene.mesh, Surface(scene.mesh))
        config = self._config
        return PreparedMitsuba(
            self._cached[1],
            cameras,
            config.samples,
            config.gradient_samples,
            config.max_depth,
            lambda: mitsuba_on(device),
        )


def _with_neighbours(pixels: Tensor, camera: Camera) -> Tensor:
    """The pixels and their neighbours, because few coverage samples may miss a silhouette."""
    mask = torch.zeros(1, 1, camera.height, camera.width, device=pixels.device)
    mask[0, 0, pixels[:, 2], pixels[:, 1]] = 1
    y, x = torch.nn.functional.max_pool2d(mask, 3, 1, 1)[0, 0].nonzero(as_tuple=True)
    return torch.stack([torch.zeros_like(x), x, y], dim=1)


def _bounding_pixels(mesh: Mesh, camera: Camera) -> Tensor:
    """Pixels (0, x, y) in the bounds of the projected vertices; all pixels if a vertex is behind the camera."""
    projected, depth = camera.project(mesh.positions.detach().cpu().numpy().astype(np.float64))
    if (depth <= 1e-6 * max(float(np.abs(depth).max()), 1e-30)).any():
        low, high = np.array([0, 0]), np.array([camera.width, camera.height])
    else:
        limit = [camera.width, camera.height]
        low = np.clip(np.floor(projected.min(axis=0)) - 1, 0, limit).astype(int)
        high = np.clip(np.ceil(projected.max(axis=0)) + 1, 0, limit).astype(int)
    y, x = torch.meshgrid(torch.arange(low[1], high[1]), torch.arange(low[0], high[0]), indexing="ij")
    return torch.stack([torch.zeros_like(x), x, y], dim=-1).reshape(-1, 3)
