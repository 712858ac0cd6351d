"""Colours of a mesh's vertices: what the photographs that see a vertex agree on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, View

_MIN_COSINE = 0.2
"""Views at a flatter angle do not count: their pixels mix places, and highlights and reflections rule there."""
_CHUNK_VERTICES = 8192


def vertex_colors(
    positions: Array, faces: NDArray[np.int64], views: Sequence[View], downsample: int = 1
) -> NDArray[np.float32]:
    """Linear colours (V, 3): weighted median over the views that see each vertex, weights the cosine of the view.

    A vertex that no view sees takes the mean of its neighbours, in rings from the seen ones; all is grey (0.5) where
    nothing is seen.
    """
    normals = vertex_normals(positions, faces)
    placed = [view for view in views if view.camera is not None]
    samples = np.zeros((len(placed), len(positions), 3), dtype=np.float16)
    weights = np.zeros((len(placed), len(positions)), dtype=np.float16)
    sees = VertexVisibility(positions, faces, normals)
    for i, view in enumerate(placed):
        assert view.camera is not None
        camera = view.camera.downsampled(downsample)
        seen, cosine, pixels = sees.from_camera(camera)
        image = view.pixels(downsample).color_linear
        samples[i, seen] = np.clip(_bilinear(image, pixels[seen] - 0.5), 0, 6e4)
        weights[i, seen] = cosine[seen]
    colors = np.zeros((len(positions), 3), dtype=np.float32)
    known = np.zeros(len(positions), dtype=bool)
    for start in range(0, len(positions), _CHUNK_VERTICES):
        part = slice(start, start + _CHUNK_VERTICES)
        colors[part], known[part] = _weighted_median(
            samples[:, part].astype(np.float32), weights[:, part].astype(np.float32)
        )
    return _fill_unseen(colors, known, faces)


def vertex_normals(positions: Array, faces: NDArray[np.int64]) -> Array:
    """Unit normals (V, 3), each face weighed by its area; zero where no face has an area."""
    a, b, c = (positions[faces[:, i]] for i in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.stack(
        [
            np.bincount(faces.reshape(-1), np.repeat(face_normals[:, axis], 3), minlength=len(positions))
            for axis in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), 0)


class VertexVisibility:
    """Which points of a mesh a camera sees; in a frame of the mesh's size, for Embree works in float32."""

    def __init__(self, positions: Array, faces: NDArray[np.int64], normals: Array) -> None:
        import open3d

        self._center = positions.mean(axis=0)
        self._size = float(np.ptp(positions, axis=0).max()) or 1.0
        self._unit = (positions - self._center) / self._size
        self._positions, self._normals = positions, normals
        edges = self._unit[faces] - self._unit[np.roll(faces, -1, axis=1)]
        # beyond a facet's own sag, or a curved surface hides itself
        self._offset = max(1e-5, 0.2 * float(np.median(np.linalg.norm(edges, axis=2))))
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=0)
        self._scene.add_triangles(
            open3d.core.Tensor.from_numpy(self._unit.astype(np.float32)),
            open3d.core.Tensor.from_numpy(faces.astype(np.uint32)),
        )

    def from_camera(self, camera: Camera) -> tuple[NDArray[np.bool_], Array, Array]:
        """Seen or not (V,), cosine between normal and view (V,), pixels (V, 2) of the mesh's vertices."""
        import open3d

        pixels, depth = camera.project(self._positions)
        toward = (camera.center - self._center) / self._size - self._unit
        distance = np.linalg.norm(toward, axis=1)
        direction = toward / np.maximum(distance, 1e-12)[:, None]
        cosine = np.einsum("ij,ij->i", self._normals, direction)
        candidate = (
            (depth > 0)
            & (cosine > _MIN_COSINE)
            & (pixels >= 0.5).all(axis=1)
            & (pixels[:, 0] <= camera.width - 0.5)
            & (pixels[:, 1] <= camera.height - 0.5)
        )
        index = np.nonzero(candidate)[0]
        origin = self._unit[index] + self._normals[index] * self._offset
        rays = np.concatenate([origin, direction[index]], axis=1).astype(np.float32)
        hidden = self._scene.test_occlusions(
            open3d.core.Tensor.from_numpy(rays), tnear=0.0, tfar=float(distance.max(initial=0.0)) + 1.0
        ).numpy()
        seen = candidate.copy()
        seen[index[hidden]] = False
        return seen, cosine, pixels


def _bilinear(image: NDArray[np.float32], at: Array) -> NDArray[np.float32]:
    """Values (N, C) of an image (H W C) at pixel coordinates (N, 2) whose centres are whole numbers."""
    height, width = image.shape[:2]
    x, y = np.clip(at[:, 0], 0, width - 1), np.clip(at[:, 1], 0, height - 1)
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    upper = image[top, left] * (1 - fx) + image[top, right] * fx
    lower = image[bottom, left] * (1 - fx) + image[bottom, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, dtype=np.float32)


def _weighted_median(
    samples: NDArray[np.float32], weights: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Median (N, 3) of samples (V, N, 3) channel by channel, and where any weight (V, N) is positive."""
    total = weights.sum(axis=0)
    known = total > 0
    order = np.argsort(np.where(weights[..., None] > 0, samples, np.inf), axis=0)
    ranked = np.take_along_axis(samples, order, axis=0)
    reached = np.cumsum(np.take_along_axis(np.broadcast_to(weights[..., None], samples.shape), order, axis=0), axis=0)
    middle = np.argmax(reached >= 0.5 * total[None, :, None], axis=0)
    median = np.take_along_axis(ranked, middle[None], axis=0)[0]
    return np.where(known[:, None], median, 0).astype(np.float32), known


def _fill_unseen(
    colors: NDArray[np.float32], known: NDArray[np.bool_], faces: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Spreads known colours over the mesh, ring by ring; pieces without any take the mean of all known ones."""
    from scipy.sparse import coo_matrix

    if not known.any():
        return np.full_like(colors, 0.5)
    count = len(colors)
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both = np.concatenate([pairs, pairs[:, ::-1]])
    adjacency = coo_matrix((np.ones(len(both), np.float32), (both[:, 0], both[:, 1])), shape=(count, count)).tocsr()
    filled, reached = colors.copy(), known.copy()
    mean = colors[known].mean(axis=0)
    while not reached.all():
        neighbours = adjacency @ reached.astype(np.float32)
        ring = ~reached & (neighbours > 0)
        if not ring.any():
            filled[~reached] = mean
            break
        filled[ring] = (adjacency[ring] @ (filled * reached[:, None])) / neighbours[ring, None]
        reached |= ring
    return filled
