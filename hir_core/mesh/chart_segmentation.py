"""Segments a large mesh into charts: charts of a simplified mesh, transferred to the triangles of the given one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_core.mesh.ray_casting import MeshQueries

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]
Labels = NDArray[np.int64]

DENOISING_STEPS = 10
"""Pairs of Taubin steps: they remove noise of the size of an edge, which would otherwise be cut into charts."""

_LESS, _MORE = 0.5, -0.53
"""Taubin's λ and μ (Taubin 1995): a step of smoothing and one that restores the volume."""

_SMOOTHING_ROUNDS = 20
"""Rounds in which a triangle takes the label that two of its neighbours have: borders become straight."""

_MIN_TRIANGLES = 24
"""Smaller pieces of a chart are joined to a neighbour."""


def denoised(positions: Positions, faces: Faces, steps: int = DENOISING_STEPS) -> Positions:
    """Positions (V, 3) after `steps` of Taubin smoothing; vertices without a face stay."""
    from scipy.sparse import coo_matrix

    count = len(positions)
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    rows, columns = np.concatenate([start, end]), np.concatenate([end, start])
    adjacency = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    degree = np.asarray(adjacency.sum(axis=1)).reshape(-1)
    x = positions.astype(np.float64)
    for factor in (_LESS, _MORE) * steps:
        mean = adjacency @ x / np.maximum(degree, 1)[:, None]
        x = np.where(degree[:, None] > 0, x + factor * (mean - x), x)
    return x


def transferred_labels(positions: Positions, faces: Faces, coarse: tuple[Positions, Faces], labels: Labels) -> Labels:
    """Label (F,) of each triangle: that of the nearest coarse triangle, with straightened borders, each label one
    connected piece.
    """
    _, nearest = MeshQueries(*coarse).nearest(positions[faces].mean(axis=1))
    neighbours = _neighbours(faces)
    found = _straightened(labels[nearest], neighbours)
    pieces = _connected(found, neighbours)
    for _ in range(_SMOOTHING_ROUNDS):
        size = np.bincount(pieces)
        small = size[pieces] < _MIN_TRIANGLES
        if not small.any():
            break
        joined = _joined_to_neighbours(pieces, small, neighbours)
        if np.array_equal(joined, pieces):
            break
        pieces = _connected(joined, neighbours)
    return pieces


def _neighbours(faces: Faces) -> NDArray[np.int64]:
    """The face across each edge (F, 3), −1 at a boundary and where more than two faces meet."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(faces.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    ranked = key[order]
    _, first, count = np.unique(ranked, return_index=True, return_counts=True)
    pair = first[count == 2]
    across = np.full(3 * len(faces), -1, dtype=np.int64)
    across[order[pair]], across[order[pair + 1]] = order[pair + 1] // 3, order[pair] // 3
    return across.reshape(-1, 3)


def _straightened(labels: Labels, neighbours: NDArray[np.int64]) -> Labels:
    found = labels.copy()
    for _ in range(_SMOOTHING_ROUNDS):
        around = np.where(neighbours >= 0, found[neighbours], -1 - np.arange(3))
        a, b, c = around.T
        majority = np.where((a == b) | (a == c), a, np.where(b == c, b, found))
        changed = (majority != found) & (majority >= 0)
        if not changed.any():
            break
        found[changed] = majority[changed]
    return found


def _connected(labels: Labels, neighbours: NDArray[np.int64]) -> Labels:
    """Numbers (F,) of the connected pieces of equal label."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    face = np.repeat(np.arange(len(labels)), 3)
    other = neighbours.reshape(-1)
    same = (other >= 0) & (labels[face] == labels[other])
    graph = coo_matrix((np.ones(int(same.sum()), np.int8), (face[same], other[same])), shape=(len(labels),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _joined_to_neighbours(pieces: Labels, small: NDArray[np.bool_], neighbours: NDArray[np.int64]) -> Labels:
    """Each small piece takes the number of the piece with which it shares the most edges; a lone one keeps its own."""
    face = np.repeat(np.arange(len(pieces)), 3)
    other = neighbours.reshape(-1)
    border = (other >= 0) & small[face] & (pieces[face] != pieces[other])
    base = int(pieces.max()) + 1
    pairs, count = np.unique(pieces[face[border]] * base + pieces[other[border]], return_counts=True)
    target = np.arange(base)
    order = np.argsort(count, kind="stable")  # the pair with the most edges is written last
    target[pairs[order] // base] = pairs[order] % base
    return target[pieces]
