"""Spans surface that no photograph shows by a membrane: below an object on a table a visual hull ends in a cone.

Rays that graze the lower edge of the object in the lowest photographs bound the hull there, so every surface between
that edge and the cone has the same outlines. The membrane across the edge is nearly the smallest of them. A round
object has no edge there; the hull touches it and is nearly right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from hir_core.capture import Camera
from hir_core.mesh.mesh_validity import component_of_vertices, self_intersections
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.mesh.self_intersection_repair import IntersectingSurface, smooth_intersections
from hir_core.mesh.texture_inpainting import harmonic_vertices
from hir_plugins.initializers.surface.isosurface import signed_volume
from hir_plugins.initializers.surface.vertex_colors import VertexVisibility, vertex_normals

Points = NDArray[np.float64]
Faces = NDArray[np.int64]

SMALLEST_SEEN_PATCH = 0.01
"""Share of the vertices below which a patch of seen ones is noise of the normals of surface that grazes the rays."""

NORMAL_RINGS = 2
"""Rings of neighbours over which normals are averaged on either side of a rim."""

EDGE_DEGREES = 20.0
"""Mean angle between the normals across the rim of a patch from which a membrane replaces the hull: below it are the
facets of hulls of round objects."""

EDGE_DEGREES_TIMES_DISTANCE = 90.0
"""Angle across the rim times mean distance to it, in degrees and edges, from which the same holds. It does not depend
on the size: the fewer edges the underside of a rod is wide, the larger is the angle. Round bodies of six sizes stay
below 78 where the angle reaches `EDGE_DEGREES`, flat ones begin at 92 (docs/studies/unseen_surface.md)."""

THICKNESS_EDGES = 2.0
"""Median edges that a membrane keeps from the surface on its other side."""


@dataclass(frozen=True)
class UnseenSurface:
    """Surface that no photograph shows, and what became of it."""

    area_share: float
    """Of the surface's area that no photograph shows."""
    moved_vertices: int
    volume_lost: float
    """Share of the volume that was outside of the membranes."""


def with_membranes(positions: Points, faces: Faces, cameras: Sequence[Camera]) -> tuple[Points, UnseenSurface]:
    """The vertices (V, 3) of a closed mesh (F, 3), those that no camera sees on membranes between the others.

    They only move inwards, and without new self-intersections. An unseen patch that goes on smoothly from what cameras
    see, as below a ball or a thin rod, stays: there the hull is the better guess.
    """
    patch = unseen_patches(positions, faces, cameras)
    share = round(_area_share(positions, faces, patch >= 0), 4)
    angle, distance = rim_angles(positions, faces, patch), mean_rim_distances(faces, patch)
    sharp = (angle >= EDGE_DEGREES) & (angle * distance >= EDGE_DEGREES_TIMES_DISTANCE)
    moved = membranes(positions, faces, np.isin(patch, np.flatnonzero(sharp)))
    count = int(np.any(moved != positions, axis=1).sum())
    if count == 0:
        return positions, UnseenSurface(share, 0, 0.0)
    lost = 1 - signed_volume(moved, faces) / signed_volume(positions, faces)
    return moved, UnseenSurface(share, count, round(lost, 5))


def membranes(positions: Points, faces: Faces, free: NDArray[np.bool_]) -> Points:
    """The vertices (V, 3), the `free` ones (V,) inwards on the harmonic surface between the others."""
    fixed = np.flatnonzero(~free)
    corners, third = np.repeat(fixed[:, None], 3, axis=1), np.full((len(fixed), 3), 1 / 3)
    membrane = harmonic_vertices(faces, len(positions), corners, third, positions[fixed])
    moved = _inside(positions, faces, np.where(free[:, None], membrane, positions))
    if np.array_equal(moved, positions):
        return moved
    surface = IntersectingSurface.of(moved, faces)
    if len(surface.hit) > 0:
        surface = smooth_intersections(surface, len(self_intersections(positions, faces)), toward=positions)
    return surface.positions


def seen_vertices(positions: Points, faces: Faces, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Vertices (V,) that at least one camera sees at no grazing angle, small patches of them left out."""
    visibility = VertexVisibility(positions, faces, vertex_normals(positions, faces))
    seen = np.zeros(len(positions), dtype=bool)
    for camera in cameras:
        rest = np.flatnonzero(~seen)
        if len(rest) == 0:
            break
        seen[rest] = visibility.among(rest).from_camera(camera)[0]
    patch = _patches(faces, seen)
    large = np.bincount(patch[patch >= 0]) >= SMALLEST_SEEN_PATCH * len(positions)
    return np.isin(patch, np.flatnonzero(large))


def unseen_patches(positions: Points, faces: Faces, cameras: Sequence[Camera]) -> NDArray[np.int64]:
    """The connected patch (V,) of surface that no camera sees to which a vertex belongs; −1 for none."""
    return _patches(faces, ~seen_vertices(positions, faces, cameras))


def _patches(faces: Faces, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The connected patch (V,) of triangles with three chosen vertices that a vertex belongs to; −1 for none."""
    patch = np.full(len(chosen), -1, dtype=np.int64)
    inside = faces[chosen[faces].all(axis=1)]
    if len(inside):
        component = component_of_vertices(inside)[1]
        patch[: len(component)] = component
    return patch


def rim_angles(positions: Points, faces: Faces, patch: NDArray[np.int64]) -> Points:
    """For each patch the mean angle between the normals on the two sides of its rim, in degrees; 0 without a rim."""
    ends = _directed_edges(faces)
    normals = vertex_normals(positions, faces)
    same = ends[patch[ends[:, 0]] == patch[ends[:, 1]]]
    for _ in range(NORMAL_RINGS):
        total = normals.copy()
        for axis in range(3):
            total[:, axis] += np.bincount(same[:, 0], normals[same[:, 1], axis], len(normals))
        normals = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(float).tiny)
    across = ends[(patch[ends[:, 0]] >= 0) & (patch[ends[:, 1]] < 0)]
    turn = np.degrees(np.arccos(np.clip((normals[across[:, 0]] * normals[across[:, 1]]).sum(axis=1), -1, 1)))
    own, patches = patch[across[:, 0]], int(patch.max(initial=-1)) + 1
    count = np.bincount(own, minlength=patches)
    return np.asarray(np.bincount(own, turn, patches) / np.maximum(count, 1))


def mean_rim_distances(faces: Faces, patch: NDArray[np.int64]) -> Points:
    """For each patch the mean number of edges from its vertices to the nearest one outside of it; 0 without a rim."""
    member, patches = patch >= 0, int(patch.max(initial=-1)) + 1
    if patches == 0 or member.all():
        return np.zeros(patches)
    ends = _directed_edges(faces)
    graph = csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (len(patch), len(patch)))
    distance = dijkstra(graph, indices=np.flatnonzero(~member), unweighted=True, min_only=True)[member]
    distance[~np.isfinite(distance)] = 0  # of a component that no photograph shows
    return np.asarray(np.bincount(patch[member], distance, patches) / np.bincount(patch[member], minlength=patches))


def _directed_edges(faces: Faces) -> NDArray[np.int64]:
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.concatenate([ends, ends[:, ::-1]])


def _inside(positions: Points, faces: Faces, target: Points) -> Points:
    """As far on the way to `target` (V, 3) as it leads through the object and keeps `THICKNESS_EDGES` from its other
    side. A way outwards ends at once.
    """
    way = target - positions
    length = np.linalg.norm(way, axis=1)
    moving = np.flatnonzero(length > 0)
    if len(moving) == 0:
        return positions
    middle, size = positions.mean(axis=0), float(np.ptp(positions, axis=0).max())
    unit = (positions - middle) / size
    edge = float(np.median(np.linalg.norm(unit[faces[:, 0]] - unit[faces[:, 1]], axis=1)))
    direction = way[moving] / length[moving, None]
    inside = unit[moving] - 0.2 * edge * vertex_normals(positions, faces)[moving]
    free = MeshQueries(unit, faces).first_distances(inside, direction).astype(np.float64)
    reach = np.clip((free - THICKNESS_EDGES * edge) * size, 0, length[moving])
    result = positions.copy()
    result[moving] += reach[:, None] * direction
    return result


def _area_share(positions: Points, faces: Faces, chosen: NDArray[np.bool_]) -> float:
    p = positions[faces]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return float(area[chosen[faces].all(axis=1)].sum() / max(float(area.sum()), np.finfo(float).tiny))
