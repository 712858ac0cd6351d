"""Mask source: the silhouette of a mesh that is already there, such as a scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture
from hir_core.errors import StageError
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.options import MeshSilhouetteOptions

if TYPE_CHECKING:
    from hir_core.scene import Scene

RAYS_PER_CALL = 1 << 20


@final
class MeshSilhouette(MaskSource):
    """The share of each pixel's rays that hit the mesh. What stands before the object is not masked."""

    def __init__(self, config: MeshSilhouetteOptions) -> None:
        self._side = config.rays_per_side

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask (H, W) for each view with a camera; `StageError` without a mesh."""
        if scene is None:
            raise StageError(
                "the mask source 'mesh_silhouette' needs a mesh; start from a scan: --set "
                "'initializers=[\"mesh_file\"]' --set initializer.mesh_file.path=FILE"
            )
        positions = scene.mesh.positions.detach().cpu().numpy().astype(np.float64)
        # rays are traced in float32: around the origin they have all digits
        center = positions.mean(axis=0)
        queries = MeshQueries(positions - center, scene.mesh.faces.cpu().numpy())
        return [None if view.camera is None else self._mask(queries, view.camera, center) for view in capture.views]

    def _mask(self, queries: MeshQueries, camera: Camera, center: NDArray[np.float64]) -> NDArray[np.float32]:
        steps = (np.arange(self._side) + 0.5) / self._side
        x = (np.arange(camera.width)[:, None] + steps).reshape(-1)
        mask = np.zeros((camera.height, camera.width), np.float32)
        rows = max(1, RAYS_PER_CALL // (camera.width * self._side**2))
        for top in range(0, camera.height, rows):
            bottom = min(top + rows, camera.height)
            y = (np.arange(top, bottom)[:, None] + steps).reshape(-1)
            origins, directions = camera.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
            hit = queries.occluded(origins - center, directions)
            blocks = hit.reshape(bottom - top, self._side, camera.width, self._side)
            mask[top:bottom] = blocks.mean(axis=(1, 3))
        return mask
