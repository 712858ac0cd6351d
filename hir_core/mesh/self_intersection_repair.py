"""Repairs self-intersections of a fitted surface.

After the first search for intersecting triangles, a round costs as much as the patches around them, not as the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hir_core.mesh.mesh_validity import self_intersections

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]
Rows = NDArray[np.int64]

_ROUNDS_PER_RING = 4
"""After this many rounds the smoothed patch grows by one ring of vertices."""
_RINGS_MAX = 5
_SEARCH_DISTANCE = 3.0
"""Around a patch, in its longest edges: triangles within it are tested again."""
_PUSH_DISTANCE = 0.1
"""Of intersecting triangles in one round, in mean edges."""
_FADE_RINGS = 2
"""Rings of neighbours over which a push fades out."""
_CELLS_MOST = 1 << 20
"""Cells of a grid along an axis, so that the number of a cell has 63 bits."""


@dataclass(frozen=True, eq=False)
class Connectivity:
    """Neighbours of the vertices of a mesh, and the faces around them."""

    faces: Faces
    vertices: int

    @cached_property
    def edges(self) -> csr_matrix:
        """(V, V): for each pair of vertices how many faces have the edge between them."""
        from scipy.sparse import csr_matrix

        ends = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        ends = np.concatenate([ends, ends[:, ::-1]])
        return csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (self.vertices, self.vertices))

    @cached_property
    def corners(self) -> csr_matrix:
        """(V, F): the faces of each vertex."""
        from scipy.sparse import csr_matrix

        count = len(self.faces)
        face = np.repeat(np.arange(count), 3)
        return csr_matrix((np.ones(3 * count), (self.faces.reshape(-1), face)), (self.vertices, count))

    def mean_of_neighbours(self, values: Positions, rows: Rows) -> Positions:
        """For each of the vertices `rows` the mean of a value over its neighbours; 0 without any."""
        part = self.edges[rows]
        degree = np.asarray(part.sum(axis=1))
        return np.asarray(part @ values / np.maximum(degree, 1))

    def grown(self, rows: Rows, rings: int) -> Rows:
        """The vertices and so many rings of neighbours, in ascending order."""
        for _ in range(rings):
            rows = np.union1d(rows, self.edges[rows].indices)
        return rows


@dataclass(frozen=True, eq=False)
class IntersectingSurface:
    """A mesh, and which of its triangles intersect others."""

    positions: Positions
    connectivity: Connectivity
    hit: NDArray[np.int64]
    """Indices of the intersecting triangles."""

    @classmethod
    def of(cls, positions: Positions, faces: Faces) -> IntersectingSurface:
        """Searches all triangles."""
        x = positions.astype(np.float64)
        return cls(x, Connectivity(faces, len(x)), self_intersections(x, faces))

    @property
    def faces(self) -> Faces:
        """The corners of all triangles."""
        return self.connectivity.faces

    def moved(self, positions: Positions, rows: Rows) -> IntersectingSurface:
        """The surface after its vertices `rows` have moved.

        Triangles that are not near them keep their state.
        """
        patch = _faces_near(positions, self.connectivity, rows)
        outside = self.hit[~np.isin(self.hit, patch)]
        hit = np.concatenate([outside, patch[self_intersections(positions, self.faces[patch])]])
        return replace(self, positions=positions, hit=hit)


def separate_sheets(surface: IntersectingSurface, allowed: int, rounds: int = 10) -> IntersectingSurface:
    """Pushes intersecting triangles apart, by a tenth of an edge a round, until at most `allowed` intersect.

    This is for sheets that graze each other, where smoothing would only shrink a thin part. Returns the surface with
    the fewest intersecting triangles of all rounds, which may be the initial one.
    """
    best = surface
    for _ in range(rounds):
        if len(surface.hit) <= max(allowed, 1):
            break
        x = surface.positions
        corners = x[surface.faces[surface.hit]]
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
        rows, push = _separating_directions(surface)
        moved = x.copy()
        moved[rows] += _PUSH_DISTANCE * edge * push
        surface = surface.moved(moved, rows[push.any(axis=1)])
        best = min(best, surface, key=lambda each: len(each.hit))
    return best


def smooth_intersections(
    surface: IntersectingSurface, allowed: int, toward: Positions | None = None, rounds: int = 60
) -> IntersectingSurface:
    """Smooths the vertices of intersecting triangles and their neighbours until at most `allowed` triangles intersect.

    With `toward`, an earlier state of the same mesh, the vertices move back to it instead. Returns the surface with the
    fewest intersecting triangles of all rounds, which may be the initial one.
    """
    best, connectivity = surface, surface.connectivity
    for round_ in range(rounds):
        if len(surface.hit) <= allowed:
            break
        rings = min(1 + round_ // _ROUNDS_PER_RING, _RINGS_MAX)
        rows = connectivity.grown(np.unique(surface.faces[surface.hit]), rings)
        x = surface.positions
        target = connectivity.mean_of_neighbours(x, rows) if toward is None else toward[rows]
        moved = x.copy()
        moved[rows] = 0.5 * x[rows] + 0.5 * target
        surface = surface.moved(moved, rows)
        best = min(best, surface, key=lambda each: len(each.hit))
    return best


def _separating_directions(surface: IntersectingSurface) -> tuple[Rows, Positions]:
    """The vertices of intersecting triangles and two rings around them, and for each the direction away from the
    nearest other intersecting triangle, faded over the rings.
    """
    from scipy.spatial import cKDTree

    hit = surface.faces[surface.hit]
    centroids = surface.positions[hit].mean(axis=1)
    _, nearest = cKDTree(centroids).query(centroids, k=2)
    away = centroids - centroids[nearest[:, 1]]
    away /= np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
    push, count = np.zeros_like(surface.positions), np.zeros(len(surface.positions))
    np.add.at(push, hit, away[:, None])
    np.add.at(count, hit, 1)
    push /= np.maximum(count, 1)[:, None]
    rows = surface.connectivity.grown(np.unique(hit), _FADE_RINGS)
    around = rows[count[rows] == 0]
    for _ in range(_FADE_RINGS):
        push[around] = surface.connectivity.mean_of_neighbours(push, around)
    return rows, push[rows]


def _faces_near(x: Positions, connectivity: Connectivity, rows: Rows) -> NDArray[np.int64]:
    """Faces of the vertices `rows`, and all faces that are near enough to intersect them, in ascending order."""
    from scipy.spatial import cKDTree

    faces = connectivity.faces
    own = np.unique(connectivity.corners[rows].indices)
    corners = x[faces[own]]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)
    distance = max(_SEARCH_DISTANCE * longest, 1e-300)
    a, b, c = (x[corner] for corner in faces.T)
    centroids = (a + b + c) / 3
    near = _in_cells_around(centroids, own, distance)
    found, _ = cKDTree(centroids[own]).query(centroids[near], distance_upper_bound=distance)
    return np.union1d(own, near[np.isfinite(found)])


def _in_cells_around(points: Positions, own: NDArray[np.int64], distance: float) -> NDArray[np.int64]:
    """The points in the cells of a grid that hold `own` points, and in the cells around these: all within `distance` of
    an own one are among them.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(distance, float((high - low).max()) / _CELLS_MOST)
    cells = ((points - low) / size).astype(np.int64) + 1
    stride = cells.max(axis=0) + 2
    key = (cells[:, 0] * stride[1] + cells[:, 1]) * stride[2] + cells[:, 2]
    steps = np.arange(-1, 2)
    around = ((steps[:, None, None] * stride[1] + steps[:, None]) * stride[2] + steps).reshape(-1)
    return np.flatnonzero(np.isin(key, np.unique(np.unique(key[own])[:, None] + around)))
