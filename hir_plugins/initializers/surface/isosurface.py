"""The zero surface of a sampled field, and its connected components."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_core.errors import StageError
from hir_plugins.initializers.surface.volume import Volume

Faces = NDArray[np.int64]


def extract_surface(volume: Volume) -> tuple[Array, Faces]:
    """The zero surface of a field that is negative on its border: a closed manifold, outward (Lewiner et al. 2003)."""
    from skimage.measure import marching_cubes

    # samples near zero would make coincident vertices; merging those would open the surface
    least = np.float32(0.01 * volume.spacing)
    values = np.where(np.abs(volume.values) < least, -least, volume.values)
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    positions = volume.origin + vertices.astype(np.float64) * volume.spacing
    triangles = faces.astype(np.int64)
    if signed_volume(positions, triangles) < 0:
        triangles = triangles[:, ::-1]
    return positions, np.ascontiguousarray(triangles)


def signed_volume(positions: Array, faces: Faces) -> float:
    """Volume enclosed by a closed mesh, positive where its triangles are counter-clockwise from outside."""
    a, b, c = (positions[faces[:, i]] - positions.mean(axis=0) for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def keep_large_components(positions: Array, faces: Faces, min_share: float) -> tuple[Array, Faces]:
    """The components with at least `min_share` of the largest component's area; cavities inside them are filled.

    Unused vertices are removed. Raises `StageError` if no component encloses a volume.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(positions)
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    face_label = label[faces[:, 0]]
    a, b, c = (positions[faces[:, i]] - positions.mean(axis=0) for i in range(3))
    areas = np.bincount(face_label, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
    volumes = np.bincount(face_label, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)
    solid = volumes > 0
    if not solid.any():
        raise StageError("the first surface encloses nothing; give it finer voxels or more photographs")
    selected = solid & (areas >= min_share * areas[solid].max())
    return without_unused_vertices(positions, faces[selected[face_label]])


def without_unused_vertices(positions: Array, faces: Faces) -> tuple[Array, Faces]:
    """The mesh without vertices that no triangle uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return positions[used], inverse.reshape(-1, 3).astype(np.int64)
