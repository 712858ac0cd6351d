"""A closed mesh for rays from cameras and for signed distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from hir_core.capture import Array, Camera
from hir_core.mesh.ray_casting import MeshQueries
from hir_plugins.initializers.surface.volume import Volume


class SweptSurface:
    """A mesh for ray casting, in its unit frame because Embree uses float32."""

    def __init__(self, positions: Array, faces: NDArray[np.int64]) -> None:
        self._center = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
        self._size = float(np.ptp(positions, axis=0).max()) or 1.0
        self._queries = MeshQueries((positions - self._center) / self._size, faces)

    def inverse_depth(self, camera: Camera) -> NDArray[np.float32]:
        """Inverse depth (H, W) of the first intersection; 0 where there is none."""
        return self._inverse(camera, last=False)

    def thickness(self, camera: Camera, front: NDArray[np.float32]) -> NDArray[np.float32]:
        """Difference in inverse depth (H, W) between the first and the last intersection."""
        back = self._inverse(camera, last=True)
        return np.where((front > 0) & (back > 0), front - back, 0).astype(np.float32)

    def signed_distance(self, points: Array) -> NDArray[np.float32]:
        """Signed distance (N,), positive inside, in world units."""
        outside = self._queries.signed_distance((points - self._center) / self._size)
        return np.asarray(-outside * self._size, dtype=np.float32)

    def _inverse(self, camera: Camera, last: bool) -> NDArray[np.float32]:
        rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
        origins, directions = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        along = directions @ camera.world_to_camera[2, :3]
        start = (origins - self._center) / self._size
        beyond = 2 * float(np.linalg.norm(start[0])) + 4
        rays = (start + directions * beyond, -directions) if last else (start, directions)
        hit = self._queries.first_distances(*rays).astype(np.float64)
        depth = (beyond - hit if last else hit) * self._size * along
        seen = np.isfinite(depth) & (depth > 0)
        inverse = np.where(seen, 1 / np.where(seen, depth, 1), 0)
        return inverse.reshape(camera.height, camera.width).astype(np.float32)


def signed_distance_volume(surface: SweptSurface, positions: Array, spacing: float) -> Volume:
    """Signed distances of a closed surface, positive inside, exact within two voxels and truncated beyond."""
    low, high = positions.min(axis=0) - 3 * spacing, positions.max(axis=0) + 3 * spacing
    size = np.ceil((high - low) / spacing).astype(int) + 1
    band = np.zeros(size, dtype=bool)
    cells = np.rint((positions - low) / spacing).astype(int)
    band[tuple(np.clip(cells, 0, size - 1).T)] = True
    band = binary_dilation(band, np.ones((3, 3, 3)), iterations=2)
    values = np.zeros(size, dtype=np.float32)
    index = np.argwhere(band)
    values[band] = surface.signed_distance(low + index * spacing)
    # each region that the band separates is inside or outside as a whole
    regions, _ = label(~band)
    firsts = np.unique(regions.reshape(-1), return_index=True)
    for number, first in zip(*firsts, strict=True):
        if number:
            position = low + np.array(np.unravel_index(first, size)) * spacing
            values[regions == number] = np.sign(surface.signed_distance(position[None])[0]) * 4 * spacing
    for axis in range(3):
        side = np.moveaxis(values, axis, 0)
        side[[0, -1]] = np.minimum(side[[0, -1]], -spacing)
    return Volume(np.clip(values, -4 * spacing, 4 * spacing), low, spacing)
