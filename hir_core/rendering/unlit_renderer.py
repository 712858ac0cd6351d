"""Renders a mesh without light: its diffuse albedo or vertex colours. Comparable with images of true albedo."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.textures.bilinear import sample_bilinear
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.mesh.ray_casting import MeshQueries

if TYPE_CHECKING:
    from hir_core.scene import Scene

Array = NDArray[np.float32]

SUPERSAMPLING = 3
"""Rays per pixel along each image axis."""


class UnlitRenderer:
    """Renders the diffuse albedo of the material; without a material the vertex colours; without colours grey."""

    def __init__(self, scene: Scene) -> None:
        mesh = scene.mesh
        self._faces = mesh.faces.detach().cpu().numpy().astype(np.int64)
        self._rays = MeshQueries(mesh.positions.detach().cpu().numpy().astype(np.float32), self._faces)
        albedo = None if scene.material is None else scene.material.diffuse_albedo.detach().cpu().numpy()
        self._texture: Array | None = None
        self._colors = np.full((1, 3), 0.5, np.float32)
        if albedo is not None and albedo.ndim == 3 and mesh.uvs is not None and mesh.topology.uv_faces is not None:
            self._texture = albedo.astype(np.float32)
            self._uvs = mesh.uvs.detach().cpu().numpy().astype(np.float64)
            self._uv_faces = mesh.topology.uv_faces.cpu().numpy()
        elif albedo is not None:
            self._colors = np.broadcast_to(albedo.reshape(-1)[:3], (1, 3)).astype(np.float32)
        elif mesh.vertex_colors is not None:
            self._colors = mesh.vertex_colors.detach().cpu().numpy().astype(np.float32)

    def render(self, camera: Camera) -> Array:
        """Linear premultiplied RGBA (H, W, 4): the mean over the rays of each pixel."""
        n = SUPERSAMPLING
        rows, columns = np.arange(camera.height * n), np.arange(camera.width * n)
        x, y = np.meshgrid((columns + 0.5) / n, (rows + 0.5) / n)
        origins, directions = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
        face, weights = self._rays.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        hit = face >= 0
        fine = np.zeros((len(face), 4), np.float32)
        fine[hit, :3], fine[hit, 3] = self._color(face[hit], weights[hit]), 1.0
        blocks = fine.reshape(camera.height, n, camera.width, n, 4)
        return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)

    def _color(self, face: NDArray[np.int64], weights: Array) -> Array:
        if self._texture is None:
            if len(self._colors) == 1:
                return np.broadcast_to(self._colors, (len(face), 3))
            return np.asarray((self._colors[self._faces[face]] * weights[..., None]).sum(axis=1), np.float32)
        uv = (self._uvs[self._uv_faces[face]] * weights[..., None]).sum(axis=1)
        height, width = self._texture.shape[:2]
        colors = sample_bilinear(self._texture, uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5)
        return colors.astype(np.float32)
