"""Mends places where a fitted surface passes through itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_core.mesh.mesh_validity import self_intersections

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

_PATIENCE = 4
"""Rounds after which the patch that gives way is widened by a ring."""
_WIDEST = 5
_REACH = 3.0
"""Longest edges of a patch around it within which other triangles are looked at again."""
_PUSH = 0.1
"""What triangles that graze each other are pushed apart by in a round, in edges."""
_RINGS = 2


def separate(positions: Positions, faces: Faces, allowed: int, rounds: int = 10) -> Positions:
    """Pushes triangles that pass through each other apart, by a tenth of an edge a round, until at most `allowed` do.

    For sheets that graze each other, where smoothing would only draw a thin part together. Returns the best state seen,
    which may be the one given.
    """
    x = positions.astype(np.float64)
    ends = _ends(faces)
    hit = self_intersections(x, faces)
    best, fewest = x, len(hit)
    for _ in range(rounds):
        if len(hit) <= max(allowed, 1):
            break
        corners = x[faces[hit]]
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
        x = x + _PUSH * edge * _apart(x, faces[hit], ends)
        hit = self_intersections(x, faces)
        if len(hit) < fewest:
            best, fewest = x, len(hit)
    return best


def untangle(
    positions: Positions, faces: Faces, allowed: int, toward: Positions | None = None, rounds: int = 60
) -> Positions:
    """Smooths the vertices of self-intersecting triangles and their neighbours until at most `allowed` are left.

    With `toward`, an earlier state of the same mesh, they go back to where they were instead. Returns the best state
    seen, which may be the one given: nothing is made worse. A round looks again only at what lies near the places that
    moved.
    """
    x = positions.astype(np.float64)
    ends = _ends(faces)
    hit = self_intersections(x, faces)
    best, fewest = x, len(hit)
    for round_ in range(rounds):
        if len(hit) <= allowed:
            break
        touched = np.zeros(len(x), dtype=bool)
        touched[faces[hit].reshape(-1)] = True
        # the longer it resists, the wider the patch that gives way
        for _ in range(min(1 + round_ // _PATIENCE, _WIDEST)):
            touched[ends[touched[ends[:, 0]], 1]] = True
        aim = _neighbours_mean(x, ends, touched) if toward is None else toward
        x = np.where(touched[:, None], 0.5 * x + 0.5 * aim, x)
        patch = _around(x, faces, touched)
        # elsewhere nothing moved: what was free there still is
        elsewhere = hit[~np.isin(hit, patch)]
        hit = np.concatenate([elsewhere, patch[self_intersections(x, faces[patch])]])
        if len(hit) < fewest:
            best, fewest = x, len(hit)
    return best


def _ends(faces: Faces) -> NDArray[np.int64]:
    """Both directions of every edge of every face (6F, 2)."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.concatenate([ends, ends[:, ::-1]])


def _apart(x: Positions, hit: Faces, ends: NDArray[np.int64]) -> Positions:
    """For each vertex the direction away from the nearest triangle that is hit, too, fading out over two rings."""
    from scipy.spatial import cKDTree

    middles = x[hit].mean(axis=1)
    _, nearest = cKDTree(middles).query(middles, k=2)
    away = middles - middles[nearest[:, 1]]
    away /= np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
    push, count = np.zeros_like(x), np.zeros(len(x))
    np.add.at(push, hit, away[:, None])
    np.add.at(count, hit, 1)
    push /= np.maximum(count, 1)[:, None]
    for _ in range(_RINGS):
        push = np.where(count[:, None] > 0, push, _neighbours_mean(push, ends, np.ones(len(x), dtype=bool)))
    return push


def _neighbours_mean(x: Positions, ends: NDArray[np.int64], touched: NDArray[np.bool_]) -> Positions:
    total, degree = np.zeros_like(x), np.zeros(len(x))
    near = touched[ends[:, 0]]
    np.add.at(total, ends[near, 0], x[ends[near, 1]])
    np.add.at(degree, ends[near, 0], 1)
    return total / np.maximum(degree, 1)[:, None]


def _around(x: Positions, faces: Faces, touched: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Faces of the touched vertices, and all that lie near enough to meet them."""
    from scipy.spatial import cKDTree

    own = touched[faces].any(axis=1)
    corners = x[faces[own]]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)
    middles = x[faces].mean(axis=1)
    distance, _ = cKDTree(middles[own]).query(middles, distance_upper_bound=max(_REACH * longest, 1e-300))
    return np.nonzero(own | np.isfinite(distance))[0]
