"""Validity of a mesh: watertightness, components, orientation, degenerate triangles and self-intersections."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

SMALLEST_CELL_QUANTILE = 0.05
"""Triangles smaller than this quantile share the finest level of the grid for self-intersections."""

LEVEL_OCTAVES = 1
"""Cells of a level are larger than those of the next finer one by this power of two."""

MOST_OCTAVES = 20
"""Cells per axis stay below 2^20: three indices fit one 64-bit key."""


@dataclass(frozen=True)
class MeshState:
    """Counts of a mesh and of its defects."""

    vertices: int
    triangles: int
    components: int
    watertight: bool
    """Every edge has two triangles, in consistent orientation."""
    genus: int
    """Handles of all components together; 0 where the mesh is not watertight."""
    degenerate: int
    """Triangles whose smallest height is below 1e-4 of their longest edge."""
    folded: int
    """Pairs of neighbouring triangles that fold back onto each other (more than 150°)."""
    self_intersecting: int
    """Triangles that intersect another one."""
    largest_dihedral_deg: float
    """Largest angle between the normals of neighbouring triangles that are not degenerate: 0 for a plane."""
    longest_edge_ratio: float
    """Longest edge, in median edges."""


def inspect_mesh(positions: Positions, faces: Faces) -> MeshState:
    """The counts of any mesh; those of an empty one are zeros."""
    positions, faces = np.asarray(positions, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    if len(faces) == 0:
        return MeshState(len(positions), 0, 0, False, 0, 0, 0, 0, 0.0, 0.0)
    p = positions[faces]
    lengths = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2)
    sides = lengths.max(axis=1)
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    doubled_area = np.linalg.norm(normals, axis=1)
    degenerate = doubled_area <= 1e-4 * sides**2
    closed, pairs, edges = _face_pairs(faces)
    unit = normals / np.maximum(doubled_area, np.finfo(float).tiny)[:, None]
    proper = ~degenerate[pairs].any(axis=1)
    cosine = (unit[pairs[:, 0]] * unit[pairs[:, 1]]).sum(axis=1)[proper]
    folded = cosine < np.cos(np.deg2rad(150))
    used = len(np.unique(faces))
    components = count_components(faces)
    genus = (2 * components - (used - edges + len(faces))) // 2 if closed else 0
    return MeshState(
        used,
        len(faces),
        components,
        closed,
        int(genus),
        int(degenerate.sum()),
        int(folded.sum()),
        len(self_intersections(positions, faces)),
        round(float(np.degrees(np.arccos(np.clip(cosine.min(initial=1.0), -1, 1)))), 2),
        round(float(sides.max() / max(float(np.median(lengths)), np.finfo(float).tiny)), 3),
    )


def count_components(faces: Faces) -> int:
    """Connected components of the vertices in use."""
    return 0 if len(faces) == 0 else int(component_of_vertices(faces)[0])


def component_of_vertices(faces: Faces) -> tuple[int, NDArray[np.int64]]:
    """The number of components, and the component of each vertex; −1 for unused vertices."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, compact = np.unique(faces, return_inverse=True)
    f = compact.reshape(-1, 3)
    rows, columns = np.concatenate([f[:, 0], f[:, 1]]), np.concatenate([f[:, 1], f[:, 2]])
    graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(used), len(used)))
    count, label = connected_components(graph, directed=False)
    component = np.full(int(used.max()) + 1, -1, dtype=np.int64)
    component[used] = label
    return int(count), component


def _face_pairs(faces: Faces) -> tuple[bool, NDArray[np.int64], int]:
    """Whether the mesh is watertight, pairs of faces (P, 2) at edges of two faces, and the number of edges."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    base = int(faces.max()) + 1
    key = np.minimum(start, end) * base + np.maximum(start, end)
    way = np.where(start < end, 1, -1)
    unique, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    closed = bool((count == 2).all() and (np.bincount(inverse, weights=way) == 0).all() and (start != end).all())
    order = np.argsort(inverse, kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])[count == 2]
    return closed, np.stack([order[first], order[first + 1]], axis=1) // 3, len(unique)


def self_intersections(positions: Positions, faces: Faces, batch: int = 400_000) -> NDArray[np.int64]:
    """Indices of triangles that intersect a triangle with which they share no vertex: an edge of one pierces the other.

    Triangles that only touch or are coplanar do not count. Candidates come from a hierarchical grid, so that a few
    triangles as large as the mesh cost no more than a comparison of each with the others.
    """
    p = np.asarray(positions, dtype=np.float64)[faces]
    if len(p) < 2 or not np.isfinite(p).all():
        return np.zeros(0, dtype=np.int64)
    low, high = p.min(axis=1), p.max(axis=1)
    hit = np.zeros(len(faces), dtype=bool)
    for first, second in _candidates(low, high, batch):
        near = (low[first] <= high[second]).all(axis=1) & (low[second] <= high[first]).all(axis=1)
        first, second = first[near], second[near]
        shared = (faces[first][:, :, None] == faces[second][:, None, :]).any(axis=(1, 2))
        first, second = first[~shared], second[~shared]
        crossing = _pierces(p[first], p[second]) | _pierces(p[second], p[first])
        hit[first[crossing]] = True
        hit[second[crossing]] = True
    return np.flatnonzero(hit)


def _candidates(low: Positions, high: Positions, batch: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs of boxes that share a cell, in batches of about `batch`; a pair may appear more than once.

    A box belongs to the level of a hierarchical grid (Mirtich 1997) whose cells are just as large as it, and lies in
    at most eight of them. It is compared with the boxes of its level and of finer levels in the same cells.
    """
    size = (high - low).max(axis=1) * 1.01
    if size.max() <= 0:
        return
    finest = max(float(np.quantile(size, SMALLEST_CELL_QUANTILE)), float(size.max()) / 2**MOST_OCTAVES)
    level = np.ceil(np.log2(np.maximum(size / finest, 1.0)) / LEVEL_OCTAVES).astype(np.int64)
    origin = low.min(axis=0)
    for current in np.unique(level):
        cell = finest * 2.0 ** (LEVEL_OCTAVES * current)
        boxes = np.flatnonzero(level <= current)
        row, key = _cells((low[boxes] - origin) // cell, (high[boxes] - origin) // cell)
        owner = boxes[row]
        order = np.lexsort((level[owner] == current, key))  # in each cell the boxes of finer levels come first
        key, owner = key[order], owner[order]
        finer = level[owner] < current
        position = np.arange(len(key))
        end = np.searchsorted(key, key, side="right")
        start = np.where(finer, _first_of_level(key, finer), position + 1)
        yield from _batches(owner, start, end, batch)


def _cells(first: Positions, last: Positions) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The row of `first` and the key of the cell, for every cell between `first` and `last`."""
    corner = first.astype(np.int64)
    span = last.astype(np.int64) - corner + 1
    amount = span.prod(axis=1)
    owner = np.repeat(np.arange(len(first)), amount)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(amount) - amount, amount)
    s = span[owner]
    cell = corner[owner] + np.stack([offset % s[:, 0], offset // s[:, 0] % s[:, 1], offset // (s[:, 0] * s[:, 1])], 1)
    return owner, (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]


def _first_of_level(key: NDArray[np.int64], finer: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Where the boxes of the current level begin in each row's cell; rows are sorted by cell, finer levels first."""
    before = np.concatenate([[0], np.cumsum(finer)])
    begin, end = np.searchsorted(key, key, side="left"), np.searchsorted(key, key, side="right")
    return np.asarray(begin + before[end] - before[begin])


def _batches(
    owner: NDArray[np.int64], start: NDArray[np.int64], end: NDArray[np.int64], batch: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Each `owner[i]` with `owner[start[i]:end[i]]`, in batches."""
    partners = end - start
    rows = np.flatnonzero(partners)
    partners, start = partners[rows], start[rows]
    total = np.cumsum(partners)
    here = 0
    while here < len(rows):
        base = total[here - 1] if here else 0
        stop = max(here + 1, int(np.searchsorted(total, base + batch, side="right")))
        count = partners[here:stop]
        i = np.repeat(rows[here:stop], count)
        j = np.repeat(start[here:stop], count) + np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
        yield owner[i], owner[j]
        here = stop


def _pierces(edges_of: Positions, triangle: Positions) -> NDArray[np.bool_]:
    """Whether an edge of each first triangle passes through the interior of the second (signs of volumes)."""
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    normal = np.cross(b - a, c - a)
    height = ((edges_of - a[:, None]) * normal[:, None]).sum(axis=2)
    result = np.zeros(len(edges_of), dtype=bool)
    for k in range(3):
        p, q = edges_of[:, k], edges_of[:, (k + 1) % 3]
        across = np.flatnonzero(height[:, k] * height[:, (k + 1) % 3] < 0)
        if len(across) == 0:
            continue
        direction = q[across] - p[across]
        volumes = [
            (np.cross(u[across] - p[across], v[across] - p[across]) * direction).sum(axis=1)
            for u, v in ((a, b), (b, c), (c, a))
        ]
        inside = np.logical_or(
            np.logical_and.reduce([v > 0 for v in volumes]), np.logical_and.reduce([v < 0 for v in volumes])
        )
        result[across[inside]] = True
    return result
