"""Normals of surface points with a normal map, in each face's own tangent frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.textures.texture_maps import sample_texels

Array = NDArray[np.float64]


def mapped_normals(
    mesh: AssetMesh, normal_map: NDArray[np.float32], corners: NDArray[np.integer], normals: Array, uvs: Array
) -> Array:
    """Unit normals (N, 3) of points with smooth normals (N, 3) and texture coordinates (N, 2) in [0, 1).

    `corners` (N, 3) are the vertices of the triangle of each point. The frame is constant in a triangle, where
    MikkTSpace interpolates it; a triangle without area in the texture keeps its smooth normals.
    """
    local = sample_texels(normal_map, True, np.minimum(uvs, 1 - 1e-9))
    p, uv = mesh.positions[corners].astype(np.float64), mesh.uvs[corners].astype(np.float64)
    e1, e2, d1, d2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    tangent = unit((e1 * d2[:, 1:] - e2 * d1[:, 1:]) * np.sign(area)[:, None])
    tangent = unit(tangent - normals * (tangent * normals).sum(-1, keepdims=True))
    up = np.cross(normals, tangent) * -np.sign(area)[:, None]  # v increases downwards
    mapped = unit(local[:, :1] * tangent + local[:, 1:2] * up + local[:, 2:] * normals)
    return np.where((area == 0)[:, None], normals, mapped)


def unit(vectors: NDArray[np.floating]) -> Array:
    """Vectors (..., 3) of length 1; shorter ones than 1e-12 become 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), 0.0), np.float64)
