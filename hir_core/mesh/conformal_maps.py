"""Least-squares conformal maps of the charts of a mesh (Lévy et al. 2002), and the test that they do not overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

_PAIRS_AT_ONCE = 4_000_000
"""Pairs of boundary edges that are tested at once: tens of megabytes."""


def conformal_map(positions: Positions, faces: Faces) -> Positions:
    """Texture coordinates (V, 2) of one chart, positions (V, 3) and faces (F, 3), with the chart's area.

    The energy of Lévy et al. 2002, as the Dirichlet energy minus the area of the map (Mullen et al. 2008); two vertices
    far from each other are fixed. A chart without boundary, or whose system is singular, gives NaN.
    """
    from scipy.sparse import bmat, coo_matrix
    from scipy.sparse.linalg import splu

    count = len(positions)
    boundary = boundary_edges(faces)
    if len(boundary) == 0:
        return np.full((count, 2), np.nan)
    rows, columns, weights = _cotangents(positions, faces)
    laplacian = coo_matrix((weights, (rows, columns)), shape=(count, count)).tocsr()
    start, end = boundary.T
    half = np.full(len(start), 0.5)
    area = coo_matrix((half, (start, end)), shape=(count, count)) - coo_matrix(
        (half, (end, start)), shape=(count, count)
    )
    energy = bmat([[laplacian, -area], [area, laplacian]], format="csc")
    pins = _far_ends(positions)
    fixed = np.array([pins[0], pins[1], count + pins[0], count + pins[1]])
    values = np.array([0.0, float(np.linalg.norm(positions[pins[1]] - positions[pins[0]])), 0.0, 0.0])
    free = np.setdiff1d(np.arange(2 * count), fixed)
    solution = np.zeros(2 * count)
    solution[fixed] = values
    try:
        inner = splu(energy[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:  # singular: faces without area
        return np.full((count, 2), np.nan)
    solution[free] = inner.solve(-energy[free][:, fixed] @ values)
    uvs = np.stack([solution[:count], solution[count:]], axis=1)
    mapped = float(np.abs(signed_areas(uvs, faces)).sum())
    true = float(0.5 * np.linalg.norm(_crosses(positions, faces), axis=1).sum())
    return uvs * np.sqrt(true / mapped) if mapped > 0 else np.full((count, 2), np.nan)


def is_injective(uvs: Positions, faces: Faces) -> bool:
    """Whether a map covers no point twice: all triangles have one orientation, and no boundary edges cross."""
    areas = signed_areas(uvs, faces)
    if not np.isfinite(areas).all() or not ((areas > 0).all() or (areas < 0).all()):
        return False
    edges = boundary_edges(faces)
    block = max(1, _PAIRS_AT_ONCE // max(len(edges), 1))
    return not any(_cross(uvs, edges[i : i + block], edges) for i in range(0, len(edges), block))


def stretch(positions: Positions, faces: Faces, uvs: Positions, uv_faces: Faces | None = None) -> float:
    """Root mean square stretch L² of a map with the surface's area (Sander et al. 2001): 1 for an isometry, else more.

    `uv_faces` (F, 3) index the coordinates where they differ from `faces`. Infinite where a face with an area is mapped
    to none; faces without area do not count.
    """
    uv_faces = faces if uv_faces is None else uv_faces
    surface = 0.5 * np.linalg.norm(_crosses(positions, faces), axis=1)
    proper = surface > 0
    faces, uv_faces, surface = faces[proper], uv_faces[proper], surface[proper]
    p, q = positions[faces], uvs[uv_faces]
    area = signed_areas(uvs, uv_faces)
    if len(area) == 0 or (area == 0).any():
        return float("inf")
    # derivatives of the surface by s and t (Sander et al., equation 1)
    difference = np.roll(q, -1, axis=1) - np.roll(q, -2, axis=1)
    along_s = (p * difference[:, :, 1:]).sum(axis=1)
    along_t = -(p * difference[:, :, :1]).sum(axis=1)
    squared = ((along_s**2).sum(axis=1) + (along_t**2).sum(axis=1)) / (2 * area) ** 2 / 2
    scale = np.abs(area).sum() / surface.sum()
    return float(np.sqrt((squared * surface).sum() / surface.sum() * scale))


def boundary_edges(faces: Faces) -> NDArray[np.int64]:
    """Directed edges (B, 2) whose opposite no face has."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    base = int(faces.max(initial=0)) + 1
    key, opposite = directed[:, 0] * base + directed[:, 1], directed[:, 1] * base + directed[:, 0]
    return directed[~np.isin(key, opposite)]


def signed_areas(uvs: Positions, faces: Faces) -> NDArray[np.float64]:
    """Areas (F,), positive for counter-clockwise triangles with v upwards."""
    a, b, c = (uvs[faces[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _crosses(positions: Positions, faces: Faces) -> Positions:
    p = positions[faces]
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


def _cotangents(positions: Positions, faces: Faces) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Rows, columns and entries of the cotangent Laplacian; positive on the diagonal."""
    p = positions[faces]
    longest = ((p - np.roll(p, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    doubled = np.maximum(np.linalg.norm(_crosses(positions, faces), axis=1), np.maximum(1e-9 * longest, 1e-300))
    rows, columns, weights = [], [], []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        cotangent = 0.5 * ((p[:, i] - p[:, k]) * (p[:, j] - p[:, k])).sum(axis=1) / doubled
        a, b = faces[:, i], faces[:, j]
        rows += [a, b, a, b]
        columns += [b, a, a, b]
        weights += [-cotangent, -cotangent, cotangent, cotangent]
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)


def _far_ends(positions: Positions) -> tuple[int, int]:
    """Two vertices far from each other: the farthest from the mean, and the farthest from that one."""
    first = int(np.linalg.norm(positions - positions.mean(axis=0), axis=1).argmax())
    return first, int(np.linalg.norm(positions - positions[first], axis=1).argmax())


def _cross(uvs: Positions, first: NDArray[np.int64], second: NDArray[np.int64]) -> bool:
    """Whether an edge of `first` (N, 2) crosses one of `second` (M, 2) with which it shares no vertex."""
    a, b = uvs[first[:, 0]][:, None], uvs[first[:, 1]][:, None]
    c, d = uvs[second[:, 0]][None], uvs[second[:, 1]][None]
    near = (np.maximum(a, b) >= np.minimum(c, d)).all(axis=2) & (np.maximum(c, d) >= np.minimum(a, b)).all(axis=2)
    near &= (first[:, :, None, None] != second.T[None, None]).all(axis=(1, 2)) if len(first) else False
    i, j = np.nonzero(near)
    a, b, c, d = a[i, 0], b[i, 0], c[0, j], d[0, j]

    def side(p: Positions, q: Positions, r: Positions) -> NDArray[np.float64]:
        return (q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]

    return bool(((side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)).any())
