"""Repairs self-intersections of a fitted surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_core.mesh.mesh_validity import self_intersections

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

_ROUNDS_PER_RING = 4
"""After this many rounds the smoothed patch grows by one ring of vertices."""
_RINGS_MAX = 5
_SEARCH_DISTANCE = 3.0
"""Around a patch, in its longest edges: triangles within it are tested again."""
_PUSH_DISTANCE = 0.1
"""Of intersecting triangles in one round, in mean edges."""
_FADE_RINGS = 2
"""Rings of neighbours over which a push fades out."""


def separate_sheets(positions: Positions, faces: Faces, allowed: int, rounds: int = 10) -> Positions:
    """Pushes intersecting triangles apart, by a tenth of an edge a round, until at most `allowed` intersect.

    This is for sheets that graze each other, where smoothing would only shrink a thin part. Returns the positions with
    the fewest intersecting triangles of all rounds, which may be the initial ones. After the first round only triangles
    near the moved vertices are tested.
    """
    x = positions.astype(np.float64)
    ends = _directed_edges(faces)
    hit = self_intersections(x, faces)
    best, fewest = x, len(hit)
    for _ in range(rounds):
        if len(hit) <= max(allowed, 1):
            break
        corners = x[faces[hit]]
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
        push = _PUSH_DISTANCE * edge * _separating_directions(x, faces[hit], ends)
        x = x + push
        hit = _intersections_after(x, faces, hit, push.any(axis=1))
        if len(hit) < fewest:
            best, fewest = x, len(hit)
    return best


def smooth_intersections(
    positions: Positions, faces: Faces, allowed: int, toward: Positions | None = None, rounds: int = 60
) -> Positions:
    """Smooths the vertices of intersecting triangles and their neighbours until at most `allowed` triangles intersect.

    With `toward`, an earlier state of the same mesh, the vertices move back to it instead. Returns the positions with
    the fewest intersecting triangles of all rounds, which may be the initial ones. After the first round only triangles
    near the moved vertices are tested.
    """
    x = positions.astype(np.float64)
    ends = _directed_edges(faces)
    hit = self_intersections(x, faces)
    best, fewest = x, len(hit)
    for round_ in range(rounds):
        if len(hit) <= allowed:
            break
        touched = np.zeros(len(x), dtype=bool)
        touched[faces[hit].reshape(-1)] = True
        for _ in range(min(1 + round_ // _ROUNDS_PER_RING, _RINGS_MAX)):
            touched[ends[touched[ends[:, 0]], 1]] = True
        target = _neighbours_mean(x, ends, touched) if toward is None else toward
        x = np.where(touched[:, None], 0.5 * x + 0.5 * target, x)
        hit = _intersections_after(x, faces, hit, touched)
        if len(hit) < fewest:
            best, fewest = x, len(hit)
    return best


def _intersections_after(
    x: Positions, faces: Faces, hit: NDArray[np.int64], touched: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """The intersecting triangles after the vertices `touched` moved; `hit` are those before.

    Only triangles near these vertices are tested: the others keep their state.
    """
    patch = _faces_near(x, faces, touched)
    outside = hit[~np.isin(hit, patch)]
    return np.concatenate([outside, patch[self_intersections(x, faces[patch])]])


def _directed_edges(faces: Faces) -> NDArray[np.int64]:
    """Both directions of every edge of every face (6F, 2)."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.concatenate([ends, ends[:, ::-1]])


def _separating_directions(x: Positions, hit: Faces, ends: NDArray[np.int64]) -> Positions:
    """For each vertex of the triangles `hit` the direction away from the nearest other one, faded over two rings."""
    from scipy.spatial import cKDTree

    centroids = x[hit].mean(axis=1)
    _, nearest = cKDTree(centroids).query(centroids, k=2)
    away = centroids - centroids[nearest[:, 1]]
    away /= np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
    push, count = np.zeros_like(x), np.zeros(len(x))
    np.add.at(push, hit, away[:, None])
    np.add.at(count, hit, 1)
    push /= np.maximum(count, 1)[:, None]
    for _ in range(_FADE_RINGS):
        push = np.where(count[:, None] > 0, push, _neighbours_mean(push, ends, np.ones(len(x), dtype=bool)))
    return push


def _neighbours_mean(x: Positions, ends: NDArray[np.int64], touched: NDArray[np.bool_]) -> Positions:
    total, degree = np.zeros_like(x), np.zeros(len(x))
    near = touched[ends[:, 0]]
    np.add.at(total, ends[near, 0], x[ends[near, 1]])
    np.add.at(degree, ends[near, 0], 1)
    return total / np.maximum(degree, 1)[:, None]


def _faces_near(x: Positions, faces: Faces, touched: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Faces of the touched vertices, and all faces that are near enough to intersect them."""
    from scipy.spatial import cKDTree

    own = touched[faces].any(axis=1)
    corners = x[faces[own]]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)
    centroids = x[faces].mean(axis=1)
    distance, _ = cKDTree(centroids[own]).query(centroids, distance_upper_bound=max(_SEARCH_DISTANCE * longest, 1e-300))
    return np.nonzero(own | np.isfinite(distance))[0]
