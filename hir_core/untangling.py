"""Mends places where a fitted surface passes through itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_core.mesh_checks import self_intersections

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]


def untangle(positions: Positions, faces: Faces, allowed: int, rounds: int = 12) -> Positions:
    """Smooths the vertices of self-intersecting triangles and their neighbours until at most `allowed` are left.

    Returns the best state seen, which may be the one given: nothing is made worse.
    """
    x = positions.astype(np.float64)
    best, fewest = x, len(self_intersections(x, faces))
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    for round_ in range(rounds):
        if fewest <= allowed:
            break
        hit = self_intersections(x, faces)
        touched = np.zeros(len(x), dtype=bool)
        touched[faces[hit].reshape(-1)] = True
        # the longer it resists, the wider the patch that gives way
        for _ in range(1 + round_ // 3):
            touched[ends[touched[ends[:, 0]], 1]] = True
        total, degree = np.zeros_like(x), np.zeros(len(x))
        near = touched[ends[:, 0]]
        np.add.at(total, ends[near, 0], x[ends[near, 1]])
        np.add.at(degree, ends[near, 0], 1)
        x = np.where(touched[:, None], 0.5 * x + 0.5 * total / np.maximum(degree, 1)[:, None], x)
        left = len(self_intersections(x, faces))
        if left < fewest:
            best, fewest = x, left
    return best
