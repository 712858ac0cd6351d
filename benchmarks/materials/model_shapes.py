"""Shapes from model files (glTF, OBJ, PLY), for larger captures of single objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from benchmarks.materials.shapes import Array, Shape

MEAN_EDGE = 0.02
"""Of the object's radius, at most. Materials are values at vertices, so that larger triangles are split."""
GLTF_TO_CAPTURE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""+Y up to +Z up."""


def shape_of_model(path: Path) -> Shape:
    """The model's triangles with smooth normals, scaled to radius 0.95.

    The connected component with most triangles is part 0, each other one a further part.
    """
    mesh = trimesh.load(path, force="mesh", process=False)
    corners = np.asarray(mesh.vertices, dtype=np.float64)
    positions, index = np.unique(corners.round(6), axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.asarray(mesh.faces)]
    normals = np.zeros_like(positions)
    np.add.at(normals, index.reshape(-1), np.asarray(mesh.vertex_normals, dtype=np.float64))
    if path.suffix.lower() in (".gltf", ".glb"):
        positions, normals = positions @ GLTF_TO_CAPTURE.T, normals @ GLTF_TO_CAPTURE.T
    positions = positions - (positions.min(axis=0) + positions.max(axis=0)) / 2
    positions *= 0.95 / np.linalg.norm(positions, axis=1).max()
    while _mean_edge(positions, faces) > MEAN_EDGE:
        positions, faces, attributes = trimesh.remesh.subdivide(positions, faces, vertex_attributes={"n": normals})
        normals = attributes["n"]
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Shape(
        positions.astype(np.float32), normals.astype(np.float32), faces.astype(np.uint32), _parts(len(positions), faces)
    )


def _mean_edge(positions: Array, faces: Array) -> float:
    return float(np.linalg.norm(positions[faces] - positions[np.roll(faces, 1, axis=1)], axis=2).mean())


def _parts(vertices: int, faces: Array) -> np.ndarray:
    links = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(vertices, vertices))
    _, labels = connected_components(graph, directed=False)
    by_size = np.argsort(-np.bincount(labels[faces[:, 0]], minlength=labels.max() + 1))
    return np.argsort(by_size)[labels]
