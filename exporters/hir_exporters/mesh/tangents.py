"""MikkTSpace tangents (Mikkelsen 2008, mikktspace.c), vectorised: the frames of fitted and of exported normal maps.

The texture's up direction is -v, for UVs have their origin top-left and green is +Y: tangents follow +u, bitangents
`w cross(normal, tangent)` follow -v. As in the original, corners are grouped around a vertex (equal position, normal
and UV) over faces that share an edge and have the same handedness, and a group's tangent is the mean of its faces'
tangents, each projected onto the vertex's tangent plane and weighed by the angle of its corner. The default of 180
degrees for splitting groups is kept, at which nothing is split.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.mesh.vertex_welding import weld

Vectors = NDArray[np.float64]

_TINY = 1e-37  # what mikktspace.c takes for zero: FLT_MIN, to a factor


def with_tangents(mesh: AssetMesh) -> AssetMesh:
    """The mesh with tangents; a vertex whose corners have different tangents becomes several.

    Triangles keep their order, vertices theirs, copies come last. A mesh that has tangents is returned as it is.
    """
    if mesh.tangents is not None:
        return mesh
    tangents, group = _grouped_tangents(mesh.positions, mesh.normals, mesh.uvs, mesh.faces)
    corner_vertex = mesh.faces.reshape(-1).astype(np.int64)
    keys = corner_vertex * (int(group.max(initial=0)) + 1) + group
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    # Of the groups at one vertex the first in order of corners keeps the vertex, others get a copy.
    by_corner = np.argsort(first)
    vertex_of = corner_vertex[first[by_corner]]
    _, keepers = np.unique(vertex_of, return_index=True)
    kept = np.zeros(len(first), dtype=bool)
    kept[keepers] = True
    index = np.empty(len(first), dtype=np.int64)
    index[by_corner[kept]] = vertex_of[kept]
    index[by_corner[~kept]] = len(mesh.positions) + np.arange(int((~kept).sum()))
    source = np.concatenate([np.arange(len(mesh.positions)), vertex_of[~kept]])
    vertex_tangents = np.tile(np.array([1, 0, 0, 1], np.float32), (len(source), 1))
    vertex_tangents[index] = tangents.reshape(-1, 4)[first]
    return replace(
        mesh,
        positions=mesh.positions[source],
        normals=mesh.normals[source],
        uvs=mesh.uvs[source],
        faces=index[number].reshape(-1, 3).astype(np.int32),
        tangents=vertex_tangents,
    )


def corner_tangents(
    positions: NDArray[np.float32], normals: NDArray[np.float32], uvs: NDArray[np.float32], faces: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Unit tangent and sign of the bitangent (F, 3, 4) of each corner; arrays as in `AssetMesh`.

    Corners of triangles without area in space or in the texture take those of their neighbours, or (1, 0, 0, 1).
    """
    return _grouped_tangents(positions, normals, uvs, faces)[0]


def _grouped_tangents(
    positions: NDArray[np.float32], normals: NDArray[np.float32], uvs: NDArray[np.float32], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Tangents (F, 3, 4), and for each corner (3F,) the number of the group it takes its tangent from."""
    corners = weld(np.concatenate([positions, normals, uvs], axis=1).astype(np.float32))[1][faces]
    place, normal = positions.astype(np.float64)[faces], normals.astype(np.float64)[faces]
    a, b, c = place.transpose(1, 0, 2)
    solid = ~((a == b).all(-1) | (b == c).all(-1) | (c == a).all(-1))
    direction, area = _face_tangents(place, uvs.astype(np.float64)[faces] * [1.0, -1.0])
    counts = solid & (area != 0) & (np.abs(direction).sum(-1) > 0)
    pairs = _neighbours(corners, solid)
    preserving = _spread_handedness(area > 0, counts, pairs[0])
    group = _lend_to_degenerate(corners, solid, _corner_groups(pairs, preserving))

    total = np.zeros((int(group.max(initial=-1)) + 1, 3))
    np.add.at(total, group.reshape(-1, 3)[counts], _contributions(place[counts], normal[counts], direction[counts]))
    tangent = np.where((np.abs(total).sum(-1) > 0)[:, None], _normalized(total), [1.0, 0.0, 0.0])
    sign = np.ones(len(total))
    sign[group.reshape(-1, 3)[solid]] = np.where(preserving[solid], 1.0, -1.0)[:, None]
    result = np.concatenate([tangent, sign[:, None]], axis=1).astype(np.float32)
    return result[group].reshape(-1, 3, 4), group


def _face_tangents(place: Vectors, uv: Vectors) -> tuple[Vectors, NDArray[np.float64]]:
    """Unit direction (F, 3) in which u grows, and twice the signed area (F,) in the texture."""
    side1, side2 = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    uv1, uv2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = uv1[:, 0] * uv2[:, 1] - uv1[:, 1] * uv2[:, 0]
    along_u = side1 * uv2[:, 1:] - side2 * uv1[:, 1:]
    return _normalized(along_u) * np.where(area > 0, 1.0, -1.0)[:, None], area


def _neighbours(corners: NDArray[np.int64], solid: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of faces (P, 2) that meet at an edge, and the corners (P, 2, 2) that do: [pair, end of the edge, face].

    Two faces are neighbours when they run along the edge in opposite directions. Where more meet, the first forwards
    goes with the first backwards, the second with the second, as the original pairs them.
    """
    start = corners.reshape(-1)
    end = corners[:, [1, 2, 0]].reshape(-1)
    usable = solid.repeat(3) & (start != end)
    edge = np.flatnonzero(usable)
    low, high = np.minimum(start, end)[edge], np.maximum(start, end)[edge]
    backward = (start > end)[edge]
    # Sort by edge, then direction, then face, and number each edge's half edges of one direction.
    order = np.lexsort([edge, backward, high, low])
    edge, low, high, backward = edge[order], low[order], high[order], backward[order]
    fresh = np.ones(len(edge), dtype=bool)
    fresh[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1]) | (backward[1:] != backward[:-1])
    rank = np.arange(len(edge)) - np.flatnonzero(fresh)[np.cumsum(fresh) - 1] if len(edge) else edge
    order = np.lexsort([backward, rank, high, low])
    edge, low, high, rank, backward = edge[order], low[order], high[order], rank[order], backward[order]
    match = (low[1:] == low[:-1]) & (high[1:] == high[:-1]) & (rank[1:] == rank[:-1]) & (backward[1:] != backward[:-1])
    first, second = edge[:-1][match], edge[1:][match]
    ends = np.stack([np.stack([first, _next_corner(second)], -1), np.stack([_next_corner(first), second], -1)], axis=1)
    return np.stack([first // 3, second // 3], axis=-1), ends


def _next_corner(corner: NDArray[np.int64]) -> NDArray[np.int64]:
    return corner // 3 * 3 + (corner + 1) % 3


def _spread_handedness(
    preserving: NDArray[np.bool_], known: NDArray[np.bool_], pairs: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Handedness of the texture on each face; faces without texture area join a neighbour's, the first that has one."""
    preserving, known = preserving.copy(), known.copy()
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    while True:
        reach = both[known[both[:, 0]] & ~known[both[:, 1]]]
        if not len(reach):
            return preserving
        target, first = np.unique(reach[:, 1], return_index=True)
        preserving[target] = preserving[reach[first, 0]]
        known[target] = True


def _corner_groups(
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]], preserving: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Number of the group of each corner (3F,): connected over edges between faces of one handedness."""
    faces, ends = pairs
    joined = ends[preserving[faces[:, 0]] == preserving[faces[:, 1]]].reshape(-1, 2)
    # Lowest corner of each group: a corner takes its neighbours' lowest, then that one's own, until all agree. Groups
    # are fans of a few corners: loading scipy's graphs would take longer.
    lowest = np.arange(3 * len(preserving))
    while True:
        both = lowest[joined]
        if (both[:, 0] == both[:, 1]).all():
            return np.unique(lowest, return_inverse=True)[1]
        np.minimum.at(lowest, lowest[joined[:, 0]], both[:, 1])
        np.minimum.at(lowest, lowest[joined[:, 1]], both[:, 0])
        lowest = lowest[lowest]


def _lend_to_degenerate(
    corners: NDArray[np.int64], solid: NDArray[np.bool_], group: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Groups in which each corner of a triangle without area is in that of the first solid corner at its vertex."""
    vertex, is_solid = corners.reshape(-1), solid.repeat(3)
    if is_solid.all():
        return group
    lender = np.full(int(vertex.max()) + 1, -1, dtype=np.int64)
    givers = np.flatnonzero(is_solid)[::-1]
    lender[vertex[givers]] = givers  # written from last to first, so the first stays
    lent = lender[vertex]
    return np.where(is_solid | (lent < 0), group, group[lent])


def _contributions(place: Vectors, normal: Vectors, direction: Vectors) -> Vectors:
    """What each corner of a face adds to its group (F, 3, 3): the face's direction, flattened, times the angle."""
    flat = _normalized(_flattened(direction[:, None, :], normal))
    before = _normalized(_flattened(np.roll(place, 1, axis=1) - place, normal))
    after = _normalized(_flattened(np.roll(place, -1, axis=1) - place, normal))
    angle = np.arccos(np.clip((before * after).sum(-1), -1.0, 1.0))
    return flat * angle[..., None]


def _flattened(vectors: Vectors, normal: Vectors) -> Vectors:
    return vectors - normal * (vectors * normal).sum(-1, keepdims=True)


def _normalized(vectors: Vectors) -> Vectors:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _TINY, vectors / np.maximum(length, _TINY), vectors)
