"""One vertex for each combination of position, texture coordinate and normal that a corner of an .obj has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hir_exporters.mesh.vertex_normals import angle_weighted_normals
from hir_exporters.reading.wavefront.obj_geometry import ObjGeometry

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VertexMesh:
    """An indexed mesh."""

    vertices: NDArray[np.int64]
    """(W, 3): indices of position, texture coordinate and normal in the geometry; -1 for none."""
    faces: NDArray[np.int64]
    """(T, 3), indices of vertices."""


def split_vertices(geometry: ObjGeometry) -> VertexMesh:
    """The combinations that occur, ordered by position, texture coordinate and normal."""
    corners = geometry.corners.reshape(-1, 3)
    group = corners[:, 0]
    for column, count in ((1, len(geometry.uvs)), (2, len(geometry.normals))):
        # a number for each combination so far, so that the product fits into 64 bits
        _, group = np.unique(group * (count + 1) + corners[:, column] + 1, return_inverse=True)
    _, first, group = np.unique(group, return_index=True, return_inverse=True)
    return VertexMesh(corners[first], group.reshape(-1, 3))


def vertex_normals(geometry: ObjGeometry, mesh: VertexMesh) -> Array:
    """Unit normals (W, 3): those of the file, else weighted by the angles of the triangles at the position.

    +Y for positions whose triangles have no area.
    """
    normals = np.zeros((len(mesh.vertices), 3))
    stored = mesh.vertices[:, 2] >= 0
    normals[stored] = geometry.normals[mesh.vertices[stored, 2]]
    with np.errstate(invalid="ignore", over="ignore"):  # numbers that `validate_asset` refuses
        missing = ~(np.linalg.norm(normals, axis=1) > 1e-12)
        if missing.any():
            around = angle_weighted_normals(geometry.positions, geometry.corners[..., 0])
            normals[missing] = around[mesh.vertices[missing, 0]]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])


def trimesh_scene(geometry: ObjGeometry, process: bool = True) -> trimesh.Scene:
    """The triangles as a scene of one mesh, without materials; texture coordinates only where all corners have one."""
    import trimesh

    if not len(geometry.corners):
        return trimesh.Scene()
    mesh = split_vertices(geometry)
    position, uv, normal = mesh.vertices.T
    visual = None
    if (uv >= 0).all():
        visual = trimesh.visual.TextureVisuals(uv=geometry.uvs[uv])
    colors = geometry.colors if visual is None else None
    loaded = trimesh.Trimesh(
        geometry.positions[position],
        mesh.faces,
        vertex_normals=geometry.normals[normal] if (normal >= 0).all() else None,
        vertex_colors=None if colors is None else _color_codes(colors)[position],
        visual=visual,
        process=process,
    )
    return trimesh.Scene(loaded)


def _color_codes(colors: Array) -> NDArray[np.uint8]:
    """Codes of 8 bits; some programs write them as such, most as numbers up to 1."""
    colors = np.nan_to_num(colors)
    return np.clip(colors * (255 if colors.max() <= 1 else 1), 0, 255).round().astype(np.uint8)
