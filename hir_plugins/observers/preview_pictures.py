"""Preview images of a scene from several sides, by ray casting with open3d; not a physically based renderer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.mesh.ray_casting import MeshQueries

if TYPE_CHECKING:
    from hir_core.scene import Scene

LIGHT_DIRECTION = np.array([-0.4, 0.7, 0.6])
"""Direction towards the light in camera coordinates: right, up, backwards."""


def preview_strip(scene: Scene, size: int, sides: int) -> NDArray[np.float32]:
    """Images (size, sides · size, 3) in sRGB from around the object, shaded by a light beside the camera."""
    positions = scene.mesh.positions.detach().cpu().numpy().astype(np.float32)
    faces = scene.mesh.faces.detach().cpu().numpy()
    center = (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = max(float(np.linalg.norm(positions - center, axis=1).max()), 1e-12)
    unit = (positions - center) / radius
    queries = MeshQueries(unit, faces)
    pictures = []
    for i in range(sides):
        frame = _frame(2 * np.pi * i / sides)
        face, weights = queries.first_hits(*_rays(frame, size))
        face, weights = face.reshape(size, size), weights.reshape(size, size, 3)
        seen = face >= 0
        a, b, c = (unit[faces[face, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
        shade = 0.25 + 0.75 * np.clip(normal @ (LIGHT_DIRECTION @ frame) / np.linalg.norm(LIGHT_DIRECTION), 0, 1)
        color = np.ones((size, size, 3))
        color[seen] = surface_colors(scene, face[seen], weights[seen]) * shade[seen][:, None]
        pictures.append(linear_to_srgb(np.clip(color, 0, 1)))
    return np.concatenate(pictures, axis=1).astype(np.float32)


def surface_colors(scene: Scene, face: NDArray[np.int64], barycentric: NDArray[np.float32]) -> NDArray[np.float64]:
    """Linear colour (N, 3) at points of triangles, given by their barycentric weights (N, 3)."""
    weights = barycentric[..., None]
    mesh, material = scene.mesh, scene.material
    if material is not None and material.diffuse_albedo.ndim == 3 and mesh.uvs is not None:
        uv_faces = mesh.faces if mesh.topology.uv_faces is None else mesh.topology.uv_faces
        corners = uv_faces.detach().cpu().numpy()[face]
        u, v = (mesh.uvs.detach().cpu().numpy()[corners] * weights).sum(axis=1).T
        texture = material.diffuse_albedo.detach().cpu().numpy()
        height, width = texture.shape[:2]
        row = np.clip((v * height).astype(int), 0, height - 1)
        linear: NDArray[np.float64] = texture[row, np.clip((u * width).astype(int), 0, width - 1)]
        return linear
    if mesh.vertex_colors is not None:
        colors = mesh.vertex_colors.detach().cpu().numpy()[mesh.faces.detach().cpu().numpy()[face]]
        linear = (colors * weights).sum(axis=1)
        return linear
    return np.full((len(face), 3), 0.6)


def _frame(angle: float) -> NDArray[np.float64]:
    """Rows: right, up and backwards axes of a camera slightly above the equator."""
    back = np.array([np.sin(angle), 0.35, np.cos(angle)])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def _rays(frame: NDArray[np.float64], size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origins and directions (size², 3) of parallel rays onto the unit ball."""
    ticks = ((np.arange(size) + 0.5) / size * 2 - 1) * 1.05
    x, y = np.meshgrid(ticks, -ticks)
    origin = x[..., None] * frame[0] + y[..., None] * frame[1] + 3 * frame[2]
    return origin.reshape(-1, 3), np.broadcast_to(-frame[2], (size * size, 3))
