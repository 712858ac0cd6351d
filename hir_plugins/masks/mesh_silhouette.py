"""Mask source: the silhouette of a mesh that is already there, such as a scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture
from hir_core.errors import StageError
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.mesh_outlines import OutlineEdges
from hir_plugins.masks.options import MeshSilhouetteOptions

if TYPE_CHECKING:
    from hir_core.scene import Scene

RAYS_PER_CALL = 1 << 20
RAYS_PER_AREA = 31
"""An odd number of rays: one that slips between two triangles decides nothing."""


@final
class MeshSilhouette(MaskSource):
    """The share of each pixel's rays that hit the mesh. What stands before the object is not masked.

    Between outlines all rays hit, or all miss: the pixels of such an area get what most of a few rays say.
    """

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
        faces = scene.mesh.faces.cpu().numpy()
        # rays are traced in float32: around the origin they have all digits
        center = positions.mean(axis=0)
        silhouette = _Silhouette(
            MeshQueries(positions - center, faces), OutlineEdges.of(positions, faces), center, self._side
        )
        return [None if view.camera is None else silhouette.mask(view.camera) for view in capture.views]


@final
class _Silhouette:
    def __init__(self, queries: MeshQueries, edges: OutlineEdges, center: NDArray[np.float64], side: int) -> None:
        self._queries, self._edges, self._center, self._side = queries, edges, center, side

    def mask(self, camera: Camera) -> NDArray[np.float32]:
        """The mask (H, W) of one camera."""
        from scipy.ndimage import label

        crossed = self._edges.pixels(camera)
        areas, count = label(~crossed)
        chosen = _few_of_each(areas, count)
        hits = self._shares(camera, chosen, 1)
        share = np.bincount(areas[chosen[:, 0], chosen[:, 1]], hits, count + 1)
        rays = np.bincount(areas[chosen[:, 0], chosen[:, 1]], minlength=count + 1)
        mask = (2 * share > rays).astype(np.float32)[areas]
        pixels = np.argwhere(crossed)
        rows = max(1, RAYS_PER_CALL // self._side**2)
        for start in range(0, len(pixels), rows):
            part = pixels[start : start + rows]
            mask[part[:, 0], part[:, 1]] = self._shares(camera, part, self._side)
        return mask

    def _shares(self, camera: Camera, pixels: NDArray[np.int64], side: int) -> NDArray[np.floating]:
        """Share of `side`² rays through each pixel (row, column) that hit the mesh."""
        steps = (np.arange(side) + 0.5) / side
        offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2)
        origins, directions = camera.rays((pixels[:, None, ::-1] + offsets).reshape(-1, 2))
        hit = self._queries.occluded(origins - self._center, directions)
        return np.asarray(hit.reshape(len(pixels), side**2).mean(axis=1))


def _few_of_each(areas: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """At most `RAYS_PER_AREA` pixels (row, column) of each area 1 … `count`, evenly spaced."""
    pixels = np.argwhere(areas > 0)
    area = areas[pixels[:, 0], pixels[:, 1]]
    order = np.argsort(area, kind="stable")
    sizes = np.bincount(area, minlength=count + 1)
    first = np.cumsum(sizes) - sizes
    rank = np.arange(len(order)) - first[area[order]]
    return pixels[order[rank % -(-sizes[area[order]] // RAYS_PER_AREA) == 0]]
