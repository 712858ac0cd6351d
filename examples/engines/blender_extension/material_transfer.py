"""The material of an imported asset on another object with the same texture coordinates."""

import bpy
import numpy as np
from mathutils import Matrix

from .hir_process import HirError
from .scan_file import render_uv_map

UV_STEPS = 2**16
"""Texture coordinates are the same if they are rounded to the same step: glTF's v is 1 - v of Blender, in float32."""

MAX_RESIDUAL = 1e-2
"""Largest root mean square distance of matched points, relative to that of the points to their mean."""


def corner_points(item):
    """World positions (N, 3) and rounded texture coordinates (N, 2) of the corners of all faces."""
    mesh = item.data
    vertices = np.empty((len(mesh.vertices), 3))
    mesh.vertices.foreach_get("co", vertices.reshape(-1))
    of_corner = np.empty(len(mesh.loops), np.int64)
    mesh.loops.foreach_get("vertex_index", of_corner)
    uv = np.empty((len(mesh.loops), 2))
    mesh.uv_layers[render_uv_map(mesh)].uv.foreach_get("vector", uv.reshape(-1))
    world = np.array(item.matrix_world)
    return vertices[of_corner] @ world[:3, :3].T + world[:3, 3], np.round(uv * UV_STEPS).astype(np.int64)


def rotation_between(source, target):
    """The rotation (3×3) of the similarity that maps points of `source` onto those of `target` with the same UV.

    Kabsch and Umeyama; raises `HirError` if the meshes are not the same.
    """
    (points, keys), (other_points, other_keys) = corner_points(source), corner_points(target)
    keys, rows = np.unique(keys, axis=0, return_index=True)
    other_keys, other_rows = np.unique(other_keys, axis=0, return_index=True)
    _, group, count = np.unique(np.concatenate([keys, other_keys]), axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    first, second = group[: len(keys)], group[len(keys) :]
    shared = np.flatnonzero(count == 2)
    rows, other_rows = rows[np.isin(first, shared)], other_rows[np.isin(second, shared)]
    if len(rows) < 4 or len(rows) < len(keys) / 2:
        raise HirError("the mesh of the run has other texture coordinates than the object")
    a, b = points[rows], other_points[other_rows]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = (s * sign).sum() / np.square(a).sum()
    if np.square(b - scale * a @ rotation.T).sum() > MAX_RESIDUAL**2 * np.square(b).sum():
        raise HirError("the mesh of the run is not that of the object")
    return Matrix(rotation.tolist())


def transfer_material(objects, target):
    """Moves the material of the imported `objects` to `target` and removes them; returns their rotation to it."""
    try:
        source = max((item for item in objects if item.type == "MESH"), key=lambda item: len(item.data.polygons))
        if not source.data.materials or not source.data.uv_layers:
            raise HirError("the mesh of the run has no material with texture coordinates")
        bpy.context.view_layer.update()  # of the objects that were just imported
        rotation = rotation_between(source, target)
        material = source.data.materials[0]
    finally:
        for mesh in {item.data for item in objects if item.type == "MESH"}:
            bpy.data.meshes.remove(mesh)  # and its objects
        bpy.data.batch_remove([item for item in bpy.data.objects if item.type == "EMPTY" and item in set(objects)])
    target.data.materials.clear()
    target.data.materials.append(material)
    target.data.shade_smooth()  # the normals were fitted on a smooth surface
    uv_map = render_uv_map(target.data)
    for node in material.node_tree.nodes:
        if node.type in {"NORMAL_MAP", "UVMAP"}:
            node.uv_map = uv_map
    return rotation
