"""Mesh simplification that preserves the UV layout: quadric half-edge collapses that keep seams closed.

The error is that of Garland and Heckbert (1997). A collapse moves a vertex onto a neighbour, so that no attribute is
interpolated. Each round applies the cheapest collapses whose neighbourhoods are disjoint. A vertex on a UV seam moves
only along the seam, both sides together; one on a border moves along the border; corners of charts do not move. No
triangle may flip, in space or in the texture. Why not a library: docs/adr/own_implementations.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.mesh.vertex_welding import weld

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

_ROUND_FRACTION = 0.3  # a round chooses from this fraction of the possible collapses, the cheapest ones
_MIN_NORMAL_COSINE = 0.2  # between a face's normals before and after a collapse
_SEAM_WEIGHT = 10.0  # of the planes that constrain seams and borders, relative to the planes of faces


@dataclass
class _State:
    """The mesh during simplification: faces by points (welded positions) and by vertices (pairs of position and UV)."""

    positions: Floats
    """(P, 3), scaled to unit size."""
    uvs: Floats
    """(V, 2)."""
    points: Indices
    """(F, 3)."""
    vertices: Indices
    """(F, 3)."""
    quadrics: Floats
    """(P, 10), upper triangle of a symmetric 4 x 4 matrix."""


def simplify(mesh: AssetMesh, triangles: int) -> AssetMesh:
    """The mesh with about `triangles` triangles, or more where seams, borders and flips allow no further collapse.

    Remaining vertices keep position, normal, UV and tangent. The result is deterministic.
    """
    if len(mesh.faces) <= triangles:
        return mesh
    first, group = weld(mesh.positions)
    positions = mesh.positions[first].astype(np.float64)
    size = float(np.ptp(positions, axis=0).max()) or 1.0
    faces = mesh.faces.astype(np.int64)
    state = _State(positions / size, mesh.uvs.astype(np.float64), group[faces], faces, np.zeros((len(positions), 10)))
    _drop_collapsed(state)
    state.quadrics = _quadrics(state)
    while len(state.points) > triangles:
        surplus = len(state.points) - triangles
        moves = _collapse_round(state, surplus, _ROUND_FRACTION)
        if not len(moves[0]):  # none of the cheapest collapses may be possible
            moves = _collapse_round(state, surplus, 1.0)
        if not len(moves[0]):
            break
        _apply(state, *moves)
    used, compact = np.unique(state.vertices, return_inverse=True)
    return replace(
        mesh,
        positions=mesh.positions[used],
        normals=mesh.normals[used],
        uvs=mesh.uvs[used],
        faces=compact.reshape(-1, 3).astype(np.int32),
        tangents=None if mesh.tangents is None else mesh.tangents[used],
    )


def _collapse_round(state: _State, surplus: int, fraction: float) -> tuple[Indices, Indices, Indices, Indices]:
    """The collapses of a round: source and target points, then replaced vertices and their replacements."""
    pairs, counts, copies, neighbors = _candidates(state)
    source, target = pairs.T
    cost = _error(state.quadrics[source] + state.quadrics[target], state.positions[target])
    # Shorter edges first where errors are equal: flat regions are simplified evenly.
    cost = cost + 1e-9 * ((state.positions[source] - state.positions[target]) ** 2).sum(-1)
    order = np.lexsort([target, cost, source])
    best = order[np.unique(source[order], return_index=True)[1]]
    best = best[np.argsort(cost[best], kind="stable")][: max(1, int(fraction * len(best)))]
    best = best[_keeps_topology(state, neighbors, source[best], target[best], counts[best])]
    best = best[_keeps_orientation(state, pairs[best], copies)]
    if fraction == 1:
        best = best[:1]  # these collapses may have a large error: one at a time
    # In a fixed random order instead of by cost: costs change slowly over a surface, and in a chain of neighbours of
    # rising cost only one could collapse in each round.
    best = best[np.random.default_rng(len(best)).permutation(len(best))]
    best = _independent(state, source[best], target[best], best)[: max(1, (surplus + 1) // 2)]
    chosen = np.isin(_pair_keys(state, copies[:, 0], copies[:, 1]), _pair_keys(state, source[best], target[best]))
    return source[best], target[best], copies[chosen, 2], copies[chosen, 3]


def _candidates(state: _State) -> tuple[Indices, Indices, Indices, Indices]:
    """Possible collapses (N, 2), the number of faces at their edges (N,), vertex replacements (v, w, old, new), and
    all pairs of neighbouring points (E, 2) in both directions, sorted.

    A collapse is possible where each vertex of the removed point has exactly one replacement across the edge, and where
    a border point stays on the border. This keeps seams closed: at a seam edge, both sides have a replacement.
    """
    ahead = [1, 2, 0]
    p, q = state.points, state.points[:, ahead]
    a, b = state.vertices, state.vertices[:, ahead]
    half = np.stack([np.stack([p, q, a, b], -1), np.stack([q, p, b, a], -1)]).reshape(-1, 4)
    keys, copy_keys = _pair_keys(state, half[:, 0], half[:, 1]), half[:, 2] * len(state.uvs) + half[:, 3]
    order = np.lexsort([copy_keys, keys])
    half, keys, copy_keys = half[order], keys[order], copy_keys[order]
    new_pair = np.concatenate([[True], keys[1:] != keys[:-1]])
    new_row = np.concatenate([[True], copy_keys[1:] != copy_keys[:-1]]) | new_pair
    new_old = np.concatenate([[True], half[1:, 2] != half[:-1, 2]]) | new_pair
    pair = np.cumsum(new_pair) - 1
    faces_at, replacements, distinct = (np.bincount(pair[flag]) for flag in (np.ones_like(new_pair), new_row, new_old))
    source, target = half[new_pair, 0], half[new_pair, 1]
    point_of = np.full(len(state.uvs), -1, dtype=np.int64)
    point_of[a] = p
    vertices_at = np.bincount(point_of[point_of >= 0], minlength=len(state.positions))
    border = np.zeros(len(state.positions), dtype=bool)
    border[source[faces_at == 1]] = True
    crowded = np.zeros(len(state.positions), dtype=bool)
    crowded[source[faces_at > 2]] = True
    possible = (replacements == distinct) & (distinct == vertices_at[source]) & ~crowded[source]
    possible &= ~border[source] | (faces_at == 1)
    neighbors = np.stack([source, target], -1)
    return neighbors[possible], faces_at[possible], half[new_row], neighbors


def _keeps_topology(
    state: _State, neighbors: Indices, source: Indices, target: Indices, faces_at: Indices
) -> NDArray[np.bool_]:
    """Link condition: the only common neighbours of the two points are the opposite corners of the edge's faces."""
    start = np.searchsorted(neighbors[:, 0], source)
    count = np.searchsorted(neighbors[:, 0], source, side="right") - start
    collapse = np.repeat(np.arange(len(source)), count)
    place = np.arange(count.sum()) + np.repeat(start - (np.cumsum(count) - count), count)
    keys = _pair_keys(state, neighbors[:, 0], neighbors[:, 1])
    wanted = _pair_keys(state, target[collapse], neighbors[place, 1])
    found = keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted
    return np.bincount(collapse[found], minlength=len(source)) == faces_at


def _keeps_orientation(state: _State, moves: Indices, copies: Indices) -> NDArray[np.bool_]:
    """Whether no face around the removed point flips, in space or in the texture."""
    target_of = np.full(len(state.positions), -1, dtype=np.int64)
    target_of[moves[:, 0]] = moves[:, 1]
    number = np.full(len(state.positions), -1, dtype=np.int64)
    number[moves[:, 0]] = np.arange(len(moves))
    # Each face is tested three times, each time with one of its corners moved.
    valid = np.ones(len(moves), dtype=bool)
    replacements = copies[target_of[copies[:, 0]] == copies[:, 1]]
    replacement = np.full(len(state.uvs), -1, dtype=np.int64)
    replacement[replacements[:, 2]] = replacements[:, 3]
    for corner in range(3):
        target = target_of[state.points[:, corner]]
        face = np.flatnonzero((target >= 0) & ~(state.points == target[:, None]).any(axis=1))
        before = state.positions[state.points[face]]
        after = before.copy()
        after[:, corner] = state.positions[target[face]]
        old, new = _normals(before), _normals(after)
        upright = (old * new).sum(-1) > _MIN_NORMAL_COSINE * np.linalg.norm(old, axis=-1) * np.linalg.norm(new, axis=-1)
        flat = state.uvs[state.vertices[face]]
        moved = flat.copy()
        moved[:, corner] = state.uvs[replacement[state.vertices[face, corner]]]
        unflipped = _areas(flat) * _areas(moved) >= 0
        valid[number[state.points[face, corner]][~(upright & unflipped)]] = False
    return valid


def _independent(state: _State, source: Indices, target: Indices, moves: Indices) -> Indices:
    """The collapses that have no earlier collapse among the neighbours of their two points."""
    last = np.iinfo(np.int64).max
    priority = np.full(len(state.positions), last)
    priority[source] = np.arange(len(source))
    edges = np.concatenate([state.points[:, [0, 1]], state.points[:, [1, 2]], state.points[:, [2, 0]]])
    least = priority.copy()
    np.minimum.at(least, edges[:, 0], priority[edges[:, 1]])
    np.minimum.at(least, edges[:, 1], priority[edges[:, 0]])
    own = np.arange(len(source))
    return moves[(least[source] == own) & (least[target] == own)]


def _apply(state: _State, source: Indices, target: Indices, old: Indices, new: Indices) -> None:
    point_map, vertex_map = np.arange(len(state.positions)), np.arange(len(state.uvs))
    point_map[source], vertex_map[old] = target, new
    state.quadrics[target] += state.quadrics[source]
    state.points, state.vertices = point_map[state.points], vertex_map[state.vertices]
    _drop_collapsed(state)


def _drop_collapsed(state: _State) -> None:
    a, b, c = state.points.T
    alive = (a != b) & (b != c) & (c != a)
    state.points, state.vertices = state.points[alive], state.vertices[alive]


def _quadrics(state: _State) -> Floats:
    """Sums over faces of squared distance times area; seams and borders add planes perpendicular to their faces."""
    corners = state.positions[state.points]
    cross = _normals(corners)
    area = np.linalg.norm(cross, axis=-1)
    normal = cross / np.maximum(area, 1e-30)[:, None]
    result = np.zeros((len(state.positions), 10))
    planes = _plane_quadrics(normal, corners[:, 0]) * area[:, None]
    for index in range(3):
        np.add.at(result, state.points[:, index], planes)
    start, end = state.vertices.reshape(-1), state.vertices[:, [1, 2, 0]].reshape(-1)
    keys = np.minimum(start, end) * len(state.uvs) + np.maximum(start, end)
    _, number, count = np.unique(keys, return_inverse=True, return_counts=True)
    boundary = np.flatnonzero(count[number] == 1)
    face, corner = np.divmod(boundary, 3)
    begin, end_position = corners[face, corner], corners[face, (corner + 1) % 3]
    side_normal = np.cross(end_position - begin, normal[face])
    length = np.linalg.norm(side_normal, axis=-1)
    planes = _plane_quadrics(side_normal / np.maximum(length, 1e-30)[:, None], begin)
    planes *= (_SEAM_WEIGHT * length**2)[:, None]
    np.add.at(result, state.points[face, corner], planes)
    np.add.at(result, state.points[face, (corner + 1) % 3], planes)
    return result


def _plane_quadrics(normal: Floats, position: Floats) -> Floats:
    plane = np.concatenate([normal, -(normal * position).sum(-1, keepdims=True)], axis=1)
    rows, columns = np.triu_indices(4)
    return plane[:, rows] * plane[:, columns]


def _error(quadrics: Floats, position: Floats) -> Floats:
    point = np.concatenate([position, np.ones((len(position), 1))], axis=1)
    rows, columns = np.triu_indices(4)
    twice = np.where(rows == columns, 1.0, 2.0)
    return np.maximum((quadrics * point[:, rows] * point[:, columns] * twice).sum(-1), 0.0)


def _pair_keys(state: _State, source: Indices, target: Indices) -> Indices:
    return source * len(state.positions) + target


def _normals(corners: Floats) -> Floats:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _areas(uvs: Floats) -> Floats:
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
