"""Makes an extracted mesh usable for later stages: manifold, without small components, evenly remeshed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture
from hir_core.errors import StageError
from hir_core.mesh.remeshing import remesh
from hir_plugins.initializers.surface.isosurface import without_unused_vertices

Faces = NDArray[np.int64]

_REMESHING_ROUNDS = 2
"""Iterations of remeshing; two suffice because voxels give even triangles."""


def pixel_size(cameras: Sequence[Camera], position: Array) -> float:
    """Size in world units of a pixel at a `position` (3,), median over the cameras."""
    return float(np.median([np.linalg.norm(c.center - position) / c.intrinsics[0, 0] for c in cameras]))


def edge_length(capture: Capture, positions: Array, pixels: float, spacing: float = 0.0) -> float:
    """Size in world units of `pixels` pixels at the mesh, at least 1.25 voxels of `spacing`; 0 for 0 pixels."""
    if pixels <= 0:
        return 0.0
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    cameras = [view.camera for view in capture.views if view.camera is not None]
    return max(pixels * pixel_size(cameras, middle), 1.25 * spacing)


def clean_mesh(
    positions: Array, faces: Faces, edge_length: float, min_component: float, seed: int = 0
) -> tuple[Array, Faces]:
    """The mesh without non-manifold edges and small components, remeshed to `edge_length`; 0 keeps its triangles.

    Components with less than a share `min_component` of the largest one's area are removed. Open meshes stay open.
    `seed` is that of `remesh`.
    Raises `StageError` if nothing is left.
    """
    positions, faces = _large_components(*_without_non_manifold_edges(positions, faces), min_component)
    if edge_length > 0:
        positions, faces = remesh(positions.astype(np.float64), faces, edge_length, _REMESHING_ROUNDS, seed)
    return positions, faces


def _without_non_manifold_edges(positions: Array, faces: Faces) -> tuple[Array, Faces]:
    """The mesh without degenerate faces; of more than two faces at an edge, the smallest are removed."""
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(positions), open3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    mesh.remove_degenerate_triangles()
    mesh.remove_duplicated_triangles()
    if not mesh.is_edge_manifold(allow_boundary_edges=True):
        mesh.remove_non_manifold_edges()
    return without_unused_vertices(np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64))


def _large_components(positions: Array, faces: Faces, min_share: float) -> tuple[Array, Faces]:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    empty = StageError("the first surface has no triangles; give it finer voxels or more photographs")
    if len(faces) == 0:
        raise empty
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(positions),) * 2)
    _, label = connected_components(graph, directed=False)
    a, b, c = (positions[faces[:, i]] - positions.mean(axis=0) for i in range(3))
    component = label[faces[:, 0]]
    areas = np.bincount(component, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
    if not (areas > 0).any():
        raise empty
    return without_unused_vertices(positions, faces[areas[component] >= min_share * areas.max()])
