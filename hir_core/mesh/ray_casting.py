"""Ray casting and nearest points on a mesh, by Embree through open3d; arrays in, arrays out.

The only wrapper of open3d's `RaycastingScene`. Geometry code and evaluation use it on the CPU. The built-in
reflectance renderers trace rays through Mitsuba instead, which also runs on CUDA.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from open3d.core import Tensor

Vectors = NDArray[np.floating]


class MeshQueries:
    """One acceleration structure over one mesh: positions (V, 3), faces (F, 3).

    Queries run in float32, so the mesh should be centred near the origin.
    """

    def __init__(self, positions: Vectors, faces: NDArray[np.integer]) -> None:
        import open3d

        self._from_numpy = open3d.core.Tensor.from_numpy
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=0)
        self._scene.add_triangles(self._float32(positions), self._from_numpy(np.ascontiguousarray(faces, np.uint32)))
        self._faces = len(faces)

    def first_faces(self, origins: Vectors, directions: Vectors) -> NDArray[np.int64]:
        """The face that each ray (N, 3), (N, 3) hits first; −1 for a miss."""
        return self.first_faces_and_distances(origins, directions)[0]

    def first_faces_and_distances(
        self, origins: Vectors, directions: Vectors
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The face that each ray (N, 3), (N, 3) hits first, −1 for a miss, and how far it is in lengths of the ray's
        direction, infinite for a miss.
        """
        hits = self._scene.cast_rays(self._rays(origins, directions))
        face = hits["primitive_ids"].numpy().astype(np.int64)
        return np.where(face < self._faces, face, -1), hits["t_hit"].numpy()

    def first_hits(self, origins: Vectors, directions: Vectors) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The face that each ray (N, 3), (N, 3) hits first, −1 for a miss, and the barycentric weights (N, 3)."""
        hits = self._scene.cast_rays(self._rays(origins, directions))
        face = hits["primitive_ids"].numpy().astype(np.int64)
        second = hits["primitive_uvs"].numpy()
        weights = np.concatenate([1 - second.sum(axis=1, keepdims=True), second], axis=1)
        return np.where(face < self._faces, face, -1), weights.astype(np.float32)

    def first_distances(self, origins: Vectors, directions: Vectors) -> NDArray[np.float32]:
        """Distance (N,) to the first hit of each ray, in lengths of its direction; infinite for a miss."""
        return np.asarray(self._scene.cast_rays(self._rays(origins, directions))["t_hit"].numpy())

    def occluded(self, origins: Vectors, directions: Vectors, reach: float = np.inf) -> NDArray[np.bool_]:
        """Whether each ray (N, 3), (N, 3) hits the mesh within `reach` lengths of its direction."""
        hit = self._scene.test_occlusions(self._rays(origins, directions), tnear=0.0, tfar=reach)
        return np.asarray(hit.numpy(), dtype=bool)

    def nearest(self, points: Vectors) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Distance (N,) of each point (N, 3) from the surface, and the nearest face (N,)."""
        queries = np.ascontiguousarray(points, dtype=np.float32)
        found = self._scene.compute_closest_points(self._from_numpy(queries))
        distance = np.linalg.norm(found["points"].numpy().astype(np.float64) - queries, axis=1)
        return distance, found["primitive_ids"].numpy().astype(np.int64)

    def nearest_points(self, points: Vectors) -> NDArray[np.float64]:
        """The nearest point (N, 3) of the surface to each point (N, 3)."""
        found = self._scene.compute_closest_points(self._float32(points))
        return np.asarray(found["points"].numpy().astype(np.float64))

    def signed_distance(self, points: Vectors) -> NDArray[np.float32]:
        """Distance (N,) of each point (N, 3) from the surface, negative inside."""
        return np.asarray(self._scene.compute_signed_distance(self._float32(points)).numpy())

    def _rays(self, origins: Vectors, directions: Vectors) -> Tensor:
        return self._float32(np.concatenate([origins, directions], axis=1))

    def _float32(self, values: Vectors) -> Tensor:
        return self._from_numpy(np.ascontiguousarray(values, dtype=np.float32))
