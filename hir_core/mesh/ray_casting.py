"""First hits and shadows of rays on a mesh, by Embree through open3d; arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class SurfaceRays:
    """One acceleration structure over one mesh; float32, so its mesh should lie near the origin."""

    def __init__(self, positions: NDArray[np.float32], faces: NDArray[np.integer]) -> None:
        import open3d

        self._tensor = open3d.core.Tensor.from_numpy
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=0)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(positions, dtype=np.float32)),
            self._tensor(np.ascontiguousarray(faces, dtype=np.uint32)),
        )
        self._faces = len(faces)

    def first_faces(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int64]:
        """The face that each ray (N, 3), (N, 3) meets first; −1 for a miss."""
        return self.first_hits(origins, directions)[0]

    def first_hits(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The face that each ray (N, 3), (N, 3) meets first, −1 for a miss, and its barycentric weights (N, 3)."""
        found = self._scene.cast_rays(self._rays(origins, directions))
        face = found["primitive_ids"].numpy().astype(np.int64)
        second = found["primitive_uvs"].numpy()
        weights = np.concatenate([1 - second.sum(axis=1, keepdims=True), second], axis=1)
        return np.where(face < self._faces, face, -1), weights.astype(np.float32)

    def occluded(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether each ray (N, 3), (N, 3) meets the mesh at all."""
        return np.asarray(self._scene.test_occlusions(self._rays(origins, directions)).numpy(), dtype=bool)

    def _rays(self, origins: NDArray[np.float32], directions: NDArray[np.float32]):  # type: ignore[no-untyped-def]
        return self._tensor(np.concatenate([origins, directions], axis=1).astype(np.float32))


class NearestPoints:
    """The nearest point on one mesh; float32, so its mesh should lie near the origin."""

    def __init__(self, positions: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        import open3d

        self._tensor = open3d.core.Tensor.from_numpy
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=0)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(positions, dtype=np.float32)),
            self._tensor(np.ascontiguousarray(faces, dtype=np.uint32)),
        )

    def __call__(self, points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Distance (N,) of each point (N, 3) from the surface, and the face (N,) that is nearest."""
        queries = np.ascontiguousarray(points, dtype=np.float32)
        found = self._scene.compute_closest_points(self._tensor(queries))
        distance = np.linalg.norm(found["points"].numpy().astype(np.float64) - queries, axis=1)
        return distance, found["primitive_ids"].numpy().astype(np.int64)
