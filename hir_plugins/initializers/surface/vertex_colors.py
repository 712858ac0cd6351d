"""Colours of a mesh's vertices: a weighted median over the photographs in which a vertex is visible.

A median over takes of different light would jump between them from vertex to vertex; it is taken within each take, and
the takes are averaged.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from hir_exporters.textures.bilinear import sample_bilinear
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, View
from hir_core.mesh.ray_casting import MeshQueries

_MIN_COSINE = 0.2
"""Smallest cosine between normal and view direction that is used: at grazing angles pixels cover large areas, and
reflections dominate."""
_CHUNK_VERTICES = 8192


def vertex_colors(
    positions: Array, faces: NDArray[np.int64], views: Sequence[View], downsample: int = 1
) -> NDArray[np.float32]:
    """Linear colours (V, 3): the median over the views in which a vertex is visible, weighted by the view's cosine; of
    several takes the mean of their medians, weighted by the sums of their cosines.

    An invisible vertex gets the mean of its neighbours, ring by ring from the visible ones. If no vertex is visible,
    all are grey (0.5).
    """
    normals = vertex_normals(positions, faces)
    posed = [view for view in views if view.camera is not None]
    samples = np.zeros((len(posed), len(positions), 3), dtype=np.float16)
    weights = np.zeros((len(posed), len(positions)), dtype=np.float16)
    visibility = VertexVisibility(positions, faces, normals)
    for i, view in enumerate(posed):
        assert view.camera is not None
        camera = view.camera.downsampled(downsample)
        visible, cosine, pixels = visibility.from_camera(camera)
        image = view.pixels(downsample).color_linear
        samples[i, visible] = np.clip(colors_at(image, pixels[visible]), 0, 6e4)
        weights[i, visible] = cosine[visible]
    colors = np.zeros((len(positions), 3), dtype=np.float32)
    known = np.zeros(len(positions), dtype=bool)
    takes = list(dict.fromkeys(view.take for view in posed)) or [""]
    members = [[i for i, view in enumerate(posed) if view.take == take] for take in takes]
    for start in range(0, len(positions), _CHUNK_VERTICES):
        part = slice(start, start + _CHUNK_VERTICES)
        of_takes = [
            (np.ascontiguousarray(samples[own, part], np.float32), np.ascontiguousarray(weights[own, part], np.float32))
            for own in members
        ]
        colors[part], known[part] = _mean_of_takes(of_takes)
    return _fill_unseen(colors, known, faces)


def vertex_normals(positions: Array, faces: NDArray[np.int64]) -> Array:
    """Area-weighted unit normals (V, 3); zero if no face of a vertex has an area."""
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
    """Which vertices of a mesh a camera sees; in a frame of the mesh's size, for Embree works in float32."""

    def __init__(self, positions: Array, faces: NDArray[np.int64], normals: Array) -> None:
        self._center = positions.mean(axis=0)
        self._size = float(np.ptp(positions, axis=0).max()) or 1.0
        unit = (positions - self._center) / self._size
        self._positions, self._normals, self._unit = positions, normals, unit
        edges = unit[faces] - unit[np.roll(faces, -1, axis=1)]
        # larger than the sagitta of a facet, or a curved surface would occlude itself
        self._offset = max(1e-5, 0.2 * float(np.median(np.linalg.norm(edges, axis=2))))
        self._queries = MeshQueries(unit, faces)

    def among(self, vertices: NDArray[np.int64]) -> VertexVisibility:
        """The same for those of these vertices with the indices `vertices` (N,); the ray tracer is shared."""
        chosen = copy.copy(self)
        chosen._positions, chosen._normals = self._positions[vertices], self._normals[vertices]
        chosen._unit = self._unit[vertices]
        return chosen

    def from_camera(self, camera: Camera) -> tuple[NDArray[np.bool_], Array, Array]:
        """Visible or not (V,), cosine between normal and view direction (V,), and pixels (V, 2) of the vertices."""
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
        hidden = self._queries.occluded(origin, direction[index], reach=float(distance.max(initial=0.0)) + 1.0)
        visible = candidate.copy()
        visible[index[hidden]] = False
        return visible, cosine, pixels


def colors_at(image: NDArray[np.float32], pixels: Array) -> NDArray[np.float32]:
    """Colours (N, 3) of an image (H, W, 3) at pixel coordinates (N, 2), centres at .5."""
    return sample_bilinear(image, pixels[:, 0] - 0.5, pixels[:, 1] - 0.5).astype(np.float32)


def _mean_of_takes(
    takes: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]],
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Mean (N, 3) of the medians of each take's samples (V, N, 3), weighted by the sums of its weights (V, N); and
    where any weight is positive."""
    medians, seen = zip(*(_weighted_median(*take) for take in takes), strict=True)
    if len(takes) == 1:
        return medians[0], seen[0]
    totals = np.stack([weights.sum(axis=0) for _, weights in takes])
    known = np.any(seen, axis=0)
    shares = totals / np.where(known, totals.sum(axis=0), 1)
    return (shares[..., None] * np.stack(medians)).sum(axis=0).astype(np.float32), known


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
    """Extends known colours over the mesh, ring by ring; components without any get the mean of all known ones."""
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
