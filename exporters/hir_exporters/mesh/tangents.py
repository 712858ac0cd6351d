"""MikkTSpace tangents (Mikkelsen 2008, mikktspace.c) in numpy: the frames of fitted and of exported normal maps.

UVs have their origin top-left and green is +Y, so that the texture's up direction is -v: tangents follow +u, bitangents
`w cross(normal, tangent)` follow -v. As in mikktspace.c, corners are grouped around a vertex (equal position, normal
and UV) over faces that share an edge and have the same handedness. A group's tangent is the mean of its faces'
tangents, each projected onto the vertex's tangent plane and weighted by the angle of its corner. The angular threshold
is the default of 180 degrees, at which no group is split. No wheel exists: docs/adr/own_implementations.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.mesh.vertex_welding import weld

Vectors = NDArray[np.float64]

_ZERO_LENGTH = 1e-37  # mikktspace.c compares with FLT_MIN, 1.2e-38


def with_tangents(mesh: AssetMesh) -> AssetMesh:
    """The mesh with tangents; a vertex whose corners have different tangents is duplicated.

    Triangles and vertices keep their order; duplicates come last. A mesh with tangents is returned unchanged.
    """
    if mesh.tangents is not None:
        return mesh
    tangents, group = _grouped_tangents(mesh.positions, mesh.normals, mesh.uvs, mesh.faces)
    corner_vertex = mesh.faces.reshape(-1).astype(np.int64)
    keys = corner_vertex * (int(group.max(initial=0)) + 1) + group
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    # The first group at a vertex, in the order of corners, keeps the vertex; further groups get duplicates.
    by_corner = np.argsort(first)
    vertex_of = corner_vertex[first[by_corner]]
    _, first_groups = np.unique(vertex_of, return_index=True)
    original = np.zeros(len(first), dtype=bool)
    original[first_groups] = True
    index = np.empty(len(first), dtype=np.int64)
    index[by_corner[original]] = vertex_of[original]
    index[by_corner[~original]] = len(mesh.positions) + np.arange(int((~original).sum()))
    source = np.concatenate([np.arange(len(mesh.positions)), vertex_of[~original]])
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

    Corners of triangles without area, in space or in the texture, get those of their neighbours, else (1, 0, 0, 1).
    """
    return _grouped_tangents(positions, normals, uvs, faces)[0]


def _grouped_tangents(
    positions: NDArray[np.float32], normals: NDArray[np.float32], uvs: NDArray[np.float32], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Tangents (F, 3, 4), and the number (3F,) of each corner's group."""
    corners = weld(np.concatenate([positions, normals, uvs], axis=1).astype(np.float32))[1][faces]
    position, normal = positions.astype(np.float64)[faces], normals.astype(np.float64)[faces]
    a, b, c = position.transpose(1, 0, 2)
    solid = ~((a == b).all(-1) | (b == c).all(-1) | (c == a).all(-1))
    direction, area = _face_tangents(position, uvs.astype(np.float64)[faces] * [1.0, -1.0])
    valid = solid & (area != 0) & (np.abs(direction).sum(-1) > 0)
    pairs = _neighbours(corners, solid)
    preserving = _propagate_handedness(area > 0, valid, pairs[0])
    group = _assign_degenerate(corners, solid, _corner_groups(pairs, preserving))

    total = np.zeros((int(group.max(initial=-1)) + 1, 3))
    np.add.at(total, group.reshape(-1, 3)[valid], _contributions(position[valid], normal[valid], direction[valid]))
    tangent = np.where((np.abs(total).sum(-1) > 0)[:, None], _normalized(total), [1.0, 0.0, 0.0])
    sign = np.ones(len(total))
    sign[group.reshape(-1, 3)[solid]] = np.where(preserving[solid], 1.0, -1.0)[:, None]
    result = np.concatenate([tangent, sign[:, None]], axis=1).astype(np.float32)
    return result[group].reshape(-1, 3, 4), group


def _face_tangents(position: Vectors, uv: Vectors) -> tuple[Vectors, NDArray[np.float64]]:
    """Unit direction (F, 3) of increasing u, and twice the signed area (F,) in the texture."""
    side1, side2 = position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]
    uv1, uv2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = uv1[:, 0] * uv2[:, 1] - uv1[:, 1] * uv2[:, 0]
    along_u = side1 * uv2[:, 1:] - side2 * uv1[:, 1:]
    return _normalized(along_u) * np.where(area > 0, 1.0, -1.0)[:, None], area


def _neighbours(corners: NDArray[np.int64], solid: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of faces (P, 2) that share an edge, and their corners (P, 2, 2) there: [pair, end of the edge, face].

    Neighbours traverse the edge in opposite directions. Where more than two faces meet, the first forward half edge is
    paired with the first backward one, the second with the second, as in mikktspace.c.
    """
    start = corners.reshape(-1)
    end = corners[:, [1, 2, 0]].reshape(-1)
    usable = solid.repeat(3) & (start != end)
    edge = np.flatnonzero(usable)
    low, high = np.minimum(start, end)[edge], np.maximum(start, end)[edge]
    backward = (start > end)[edge]
    # Sort by edge, direction and face; then number the half edges of one direction at each edge.
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


def _propagate_handedness(
    preserving: NDArray[np.bool_], known: NDArray[np.bool_], pairs: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Handedness of the texture on each face; faces without texture area take that of the first neighbour with one."""
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
    """Number of each corner's group (3F,): corners connected by edges between faces of one handedness."""
    faces, ends = pairs
    joined = ends[preserving[faces[:, 0]] == preserving[faces[:, 1]]].reshape(-1, 2)
    # Connected components by label propagation with pointer jumping. Groups have few corners: this takes less time
    # than importing scipy's graph functions.
    lowest = np.arange(3 * len(preserving))
    while True:
        both = lowest[joined]
        if (both[:, 0] == both[:, 1]).all():
            return np.unique(lowest, return_inverse=True)[1]
        np.minimum.at(lowest, lowest[joined[:, 0]], both[:, 1])
        np.minimum.at(lowest, lowest[joined[:, 1]], both[:, 0])
        lowest = lowest[lowest]


def _assign_degenerate(
    corners: NDArray[np.int64], solid: NDArray[np.bool_], group: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The groups, with corners of triangles without area in the group of the first other corner at their vertex."""
    vertex, is_solid = corners.reshape(-1), solid.repeat(3)
    if is_solid.all():
        return group
    first_corner = np.full(int(vertex.max()) + 1, -1, dtype=np.int64)
    solid_corners = np.flatnonzero(is_solid)[::-1]
    first_corner[vertex[solid_corners]] = solid_corners  # assigned from last to first: the first corner remains
    source = first_corner[vertex]
    return np.where(is_solid | (source < 0), group, group[source])


def _contributions(position: Vectors, normal: Vectors, direction: Vectors) -> Vectors:
    """Contribution (F, 3, 3) of each corner to its group: the face's direction in the tangent plane times the angle."""
    tangent = _normalized(_projected(direction[:, None, :], normal))
    before = _normalized(_projected(np.roll(position, 1, axis=1) - position, normal))
    after = _normalized(_projected(np.roll(position, -1, axis=1) - position, normal))
    angle = np.arccos(np.clip((before * after).sum(-1), -1.0, 1.0))
    return tangent * angle[..., None]


def _projected(vectors: Vectors, normal: Vectors) -> Vectors:
    """Vectors projected onto the plane of a unit normal."""
    return vectors - normal * (vectors * normal).sum(-1, keepdims=True)


def _normalized(vectors: Vectors) -> Vectors:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _ZERO_LENGTH, vectors / np.maximum(length, _ZERO_LENGTH), vectors)
