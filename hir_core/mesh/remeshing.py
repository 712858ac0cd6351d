"""Isotropic remeshing (Botsch & Kobbelt 2004): split, collapse, flip, relax, each as a few passes over whole arrays.

Of operations that touch the same neighbourhood only the one of the lowest rank runs in a pass, so that a pass over
arrays is equivalent to single operations. Collapses keep the topology: a closed manifold mesh stays closed and
manifold and keeps its genus.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.mesh.ray_casting import MeshQueries

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

SPLIT, COLLAPSE = 4 / 3, 4 / 5
"""Longer edges are split and shorter ones collapsed, in multiples of the target (Botsch & Kobbelt 2004)."""

LEAST_NORMAL_COSINE = 0.3
"""Of the angle by which a collapse may rotate the normal of a triangle."""


def remesh(
    positions: Positions, faces: Faces, edge_length: float, rounds: int = 4, seed: int = 0
) -> tuple[Positions, Faces]:
    """A mesh of the same surface and topology with edges near `edge_length`; its vertices lie on the given surface.

    Positions are returned in float64. An empty mesh, or one without area, is returned as it is. Edges of more than two
    faces and boundary edges stay. `seed` decides the order in which short edges collapse.
    """
    edge_length = float(edge_length)
    if len(faces) == 0 or not np.isfinite(edge_length) or edge_length <= 0 or not np.isfinite(positions).all():
        return positions.astype(np.float64), faces.astype(np.int64)
    surface = _Surface(positions, faces)
    x, f = _compact(positions.astype(np.float64), faces[_proper(faces)].astype(np.int64))
    if len(f) == 0:
        return positions.astype(np.float64), faces.astype(np.int64)
    for _ in range(rounds):
        x, f = _split_long(x, f, edge_length * SPLIT)
        x, f = _collapse_short(x, f, edge_length, seed)
        f = _flip(x, f)
        x = surface.nearest(_relax(x, f))
    return x, f


def mean_edge_length(positions: Positions, faces: Faces) -> float:
    """Mean over all corners of all triangles; 0 for an empty mesh."""
    if len(faces) == 0:
        return 0.0
    p = positions[faces]
    return float(np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).mean())


def surface_area(positions: Positions, faces: Faces) -> float:
    """Sum of the triangles' areas."""
    p = positions[faces].astype(np.float64)
    return float(0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum())


class _Surface:
    """Nearest points on the surface before remeshing."""

    def __init__(self, positions: Positions, faces: Faces) -> None:
        # queries run in float32: about the centre no digits are lost
        self._center = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
        self._queries = MeshQueries(positions - self._center, faces)

    def nearest(self, points: Positions) -> Positions:
        moved = self._queries.nearest_points(points - self._center) + self._center
        return np.where(np.isfinite(moved), moved, points)


@dataclass(frozen=True)
class _Edges:
    ends: NDArray[np.int64]
    """E 2, lower index first."""
    of_corner: NDArray[np.int64]
    """F 3: the edge from corner k to corner k + 1."""
    faces: NDArray[np.int64]
    """E 2: its first two faces, −1 where there is none."""
    count: NDArray[np.int64]
    """Faces of each edge."""


def _edges(faces: Faces, vertices: int) -> _Edges:
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * vertices + np.maximum(start, end)
    order, ordered = _sorted(key)
    is_first = np.ones(len(key), dtype=bool)
    is_first[1:] = ordered[1:] != ordered[:-1]
    first = np.flatnonzero(is_first)
    unique, count = ordered[first], np.diff(first, append=len(key))
    inverse = np.empty(len(key), dtype=np.int64)
    inverse[order] = np.cumsum(is_first) - 1
    pair = np.full((len(unique), 2), -1, dtype=np.int64)
    pair[:, 0] = order[first] // 3
    twice = count > 1
    pair[twice, 1] = order[first[twice] + 1] // 3
    return _Edges(np.stack([unique // vertices, unique % vertices], axis=1), inverse.reshape(-1, 3), pair, count)


def _sorted(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The stable order of the keys, and the keys in it. torch sorts integers in a third of numpy's time."""
    ordered, order = torch.sort(torch.from_numpy(keys), stable=True)
    return order.numpy(), ordered.numpy()


def _proper(faces: Faces) -> NDArray[np.bool_]:
    return (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])


def _compact(positions: Positions, faces: Faces) -> tuple[Positions, Faces]:
    used = np.zeros(len(positions), dtype=bool)
    used[faces.reshape(-1)] = True
    return positions[used], (np.cumsum(used) - 1)[faces]


def _lengths(positions: Positions, ends: NDArray[np.int64]) -> NDArray[np.float64]:
    return _norm((positions[ends[:, 1]] - positions[ends[:, 0]]).T)


def _normals(positions: Positions, faces: Faces) -> Positions:
    """(3, F) unit normals; 0 where a triangle has no area."""
    a, b, c = (positions[faces[:, k]].T for k in range(3))
    n = _cross(b - a, c - a)
    length = _norm(n)
    return np.where(length > 0, n / np.maximum(length, np.finfo(float).tiny), 0.0)


# Vectors are (3, N) here, because numpy is slower along a dimension of three.


def _cross(a: Positions, b: Positions) -> Positions:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _dot(a: Positions, b: Positions) -> NDArray[np.float64]:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _norm(a: Positions) -> NDArray[np.float64]:
    return np.sqrt(_dot(a, a))


def _sums(index: NDArray[np.int64], values: Positions, count: int) -> Positions:
    """(3, `count`): sum of the values (3, N) of each index."""
    return np.stack([np.bincount(index, weights, count) for weights in values])


def _split_long(x: Positions, f: Faces, limit: float) -> tuple[Positions, Faces]:
    """Halves long edges until none is left. A triangle with one, two or three halved edges becomes two, three or four
    triangles.
    """
    for _ in range(12):
        edges = _edges(f, len(x))
        long = _lengths(x, edges.ends) > limit
        if not long.any():
            break
        number = np.full(len(long), -1, dtype=np.int64)
        number[long] = len(x) + np.arange(long.sum())
        x = np.concatenate([x, 0.5 * (x[edges.ends[long, 0]] + x[edges.ends[long, 1]])])
        middle = number[edges.of_corner]
        halved = middle >= 0
        parts = [f[~halved.any(axis=1)]]
        amount = halved.sum(axis=1)
        one = amount == 1
        a, b, c, ab, _, _ = _rotated(f[one], middle[one], halved[one].argmax(axis=1))
        parts += [np.stack([a, ab, c], 1), np.stack([ab, b, c], 1)]
        two = amount == 2
        a, b, c, _, bc, ca = _rotated(f[two], middle[two], (~halved[two]).argmax(axis=1))
        parts.append(np.stack([bc, c, ca], 1))
        # the quad a b bc ca along its shorter diagonal
        straight = (np.linalg.norm(x[a] - x[bc], axis=1) <= np.linalg.norm(x[b] - x[ca], axis=1))[:, None]
        parts += [
            np.where(straight, np.stack([a, b, bc], 1), np.stack([a, b, ca], 1)),
            np.where(straight, np.stack([a, bc, ca], 1), np.stack([b, bc, ca], 1)),
        ]
        three = amount == 3
        (a, b, c), (ab, bc, ca) = f[three].T, middle[three].T
        parts += [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        f = np.concatenate(parts)
    return x, f


def _rotated(faces: Faces, middle: NDArray[np.int64], first: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Corners and edge midpoints of each triangle, rotated so that corner `first` comes first."""
    order = (np.arange(3)[None] + first[:, None]) % 3
    return (*np.take_along_axis(faces, order, 1).T, *np.take_along_axis(middle, order, 1).T)


def _collapse_short(x: Positions, f: Faces, length: float, seed: int) -> tuple[Positions, Faces]:
    """Merges the ends of short edges where topology and orientation allow, an independent set at a time."""
    random = np.random.default_rng(seed)
    sparse_passes = 0
    for _ in range(80):
        edges = _edges(f, len(x))
        chosen = _collapsible(x, f, edges, length, random)
        a, b = edges.ends[chosen].T
        x[a] = 0.5 * (x[a] + x[b])
        target = np.arange(len(x))
        target[b] = a
        f = target[f]
        before = len(f)
        x, f = _compact(x, f[_proper(f)])
        # the sets are random: a single pass with few collapses may be chance, two in a row are not
        sparse_passes = sparse_passes + 1 if before - len(f) < 0.003 * before else 0
        if sparse_passes == 2:
            break
    return x, f


def _collapsible(
    x: Positions, f: Faces, edges: _Edges, length: float, random: np.random.Generator
) -> NDArray[np.int64]:
    """Short edges with disjoint neighbourhoods, in random order: an edge that cannot collapse must not block its
    neighbours for ever.
    """
    boundary = np.zeros(len(x), dtype=bool)
    boundary[edges.ends[edges.count != 2].reshape(-1)] = True
    a, b = edges.ends.T
    index = np.flatnonzero((_lengths(x, edges.ends) < COLLAPSE * length) & ~boundary[a] & ~boundary[b])
    last = len(index)
    rank = np.full(len(a), last)
    rank[index] = random.permutation(last)
    near = np.full(len(x), last)
    np.minimum.at(near, edges.ends[index].reshape(-1), rank[index].repeat(2))
    wide = near.copy()
    np.minimum.at(wide, a, near[b])
    np.minimum.at(wide, b, near[a])
    index = index[rank[index] == np.minimum(wide[a[index]], wide[b[index]])]
    valence = np.bincount(edges.ends.reshape(-1), minlength=len(x))
    index = index[_link_condition(f, edges, index, valence, len(x))]
    return index[_keeps_shape(x, f, edges.ends[index], SPLIT * length)]


def _link_condition(
    f: Faces, edges: _Edges, index: NDArray[np.int64], valence: NDArray[np.int64], vertices: int
) -> NDArray[np.bool_]:
    """The link condition: only the two opposite corners neighbour both ends, else the topology changes; and both keep
    at least three neighbours.
    """
    from scipy.sparse import csr_matrix

    a, b = edges.ends[index].T
    both = np.concatenate([edges.ends, edges.ends[:, ::-1]])
    adjacency = csr_matrix((np.ones(len(both), dtype=np.int32), (both[:, 0], both[:, 1])), shape=(vertices, vertices))
    common = np.asarray(adjacency[a].multiply(adjacency[b]).sum(axis=1)).reshape(-1)
    opposite = np.stack([f[edges.faces[index, k]].sum(axis=1) - a - b for k in (0, 1)], axis=1)
    return (common == 2) & (opposite[:, 0] != opposite[:, 1]) & (valence[opposite] > 4).all(axis=1)


def _keeps_shape(x: Positions, f: Faces, ends: NDArray[np.int64], longest: float) -> NDArray[np.bool_]:
    """Whether merging each pair at its midpoint flips no triangle around it and makes no edge longer than `longest`."""
    corner = f.reshape(-1)
    order, _ = _sorted(corner)
    start = np.concatenate([[0], np.cumsum(np.bincount(corner, minlength=len(x)))])
    good = np.ones(len(ends), dtype=bool)
    middle = 0.5 * (x[ends[:, 0]] + x[ends[:, 1]])
    for side in (0, 1):
        vertex = ends[:, side]
        count = start[vertex + 1] - start[vertex]
        pair = np.repeat(np.arange(len(ends)), count)
        offset = np.arange(len(pair)) - (np.cumsum(count) - count)[pair]
        slot = order[start[vertex[pair]] + offset]
        face, k = slot // 3, slot % 3
        first, second = f[face, (k + 1) % 3], f[face, (k + 2) % 3]
        merged = ends[pair, 1 - side]
        removed = (first == merged) | (second == merged)
        p, q, before, after = x[first].T, x[second].T, x[vertex[pair]].T, middle[pair].T
        old, new = _cross(p - before, q - before), _cross(p - after, q - after)
        size = _norm(old) * _norm(new)
        bad = (_dot(old, new) <= LEAST_NORMAL_COSINE * size) | (_norm(p - after) > longest)
        good[pair[bad & ~removed]] = False
    return good


def _flip(x: Positions, f: Faces, passes: int = 4) -> Faces:
    """Flips edges where that brings valences nearer to six (four at a boundary) and creates no fold."""
    for _ in range(passes):
        edges = _edges(f, len(x))
        inner = np.flatnonzero(edges.count == 2)
        if len(inner) == 0:
            break
        left, right = edges.faces[inner].T
        k = (edges.of_corner[left] == inner[:, None]).argmax(axis=1)
        j = (edges.of_corner[right] == inner[:, None]).argmax(axis=1)
        a, b, c = (f[left, (k + i) % 3] for i in range(3))
        d = f[right, (j + 2) % 3]
        # the triangles must have consistent orientation along the edge
        oriented = f[right, j] == b
        ideal = np.full(len(x), 6)
        ideal[edges.ends[edges.count != 2].reshape(-1)] = 4
        excess = np.bincount(edges.ends.reshape(-1), minlength=len(x)) - ideal
        gain = 2 * (excess[a] + excess[b] - excess[c] - excess[d]) - 4
        gaining = (gain > 0) & oriented & (c != d)
        left, right, a, b, c, d, gain = (each[gaining] for each in (left, right, a, b, c, d, gain))
        mean = _normals(x, f[left]) + _normals(x, f[right])
        mean /= np.maximum(_norm(mean), 1e-30)
        new1, new2 = np.stack([a, d, c], 1), np.stack([d, b, c], 1)
        flat = (_dot(_normals(x, new1), mean) > 0.7) & (_dot(_normals(x, new2), mean) > 0.7)
        key = edges.ends[:, 0] * len(x) + edges.ends[:, 1]
        new_key = np.minimum(c, d) * len(x) + np.maximum(c, d)
        fresh = key[np.searchsorted(key, new_key).clip(max=len(key) - 1)] != new_key
        index = np.flatnonzero(flat & fresh)
        if len(index) == 0:
            break
        quad = np.stack([a, b, c, d], 1)[index]
        rank = np.empty(len(index), dtype=np.int64)
        rank[np.argsort(-gain[index], kind="stable")] = np.arange(len(index))
        lowest = np.full(len(x), np.iinfo(np.int64).max)
        np.minimum.at(lowest, quad.reshape(-1), rank.repeat(4))
        index = index[(lowest[quad] == rank[:, None]).all(axis=1)]
        f = f.copy()
        f[left[index]], f[right[index]] = new1[index], new2[index]
    return f


def _relax(x: Positions, f: Faces) -> Positions:
    """Moves each vertex in its tangent plane to the mean of its neighbours; boundaries stay."""
    edges = _edges(f, len(x))
    a, b = edges.ends.T
    total = _sums(np.concatenate([a, b]), x[np.concatenate([b, a])].T, len(x))
    degree = np.bincount(edges.ends.reshape(-1), minlength=len(x))
    step = total / np.maximum(degree, 1) - x.T
    p, q, r = (x[f[:, k]].T for k in range(3))
    normal = _sums(f.reshape(-1), _cross(q - p, r - p).repeat(3, axis=1), len(x))
    normal /= np.maximum(_norm(normal), np.finfo(float).tiny)
    step -= normal * _dot(step, normal)
    step[:, edges.ends[edges.count != 2].reshape(-1)] = 0
    return x + 0.7 * step.T
