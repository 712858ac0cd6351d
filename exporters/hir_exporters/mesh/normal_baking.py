"""Bakes the normals of a fine mesh into a tangent space normal map for a coarse mesh with the same UV layout.

Simplification keeps the UVs of the remaining vertices (`hir_exporters.mesh.simplification`), so that a texel is the
same surface point on both meshes and no rays are needed. Tangent frames are those of shaders: interpolated normal and
MikkTSpace tangent, not normalised, and `cross(normal, tangent) * sign`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.mesh.tangents import with_tangents
from hir_exporters.textures.texture_maps import resize
from hir_exporters.textures.uv_rasterization import TexelCoverage, dilate, rasterize_uvs

Array = NDArray[np.float64]

MAX_OVERLAP: Final = 0.01
"""Largest fraction of texels that several triangles may cover; with more, one map cannot be right for all of them."""

_DILATION_STEPS: Final = 8  # texels beyond the border of a chart, for filters and mipmaps


def baked_normals(
    fine: AssetMesh, normal: NDArray[np.float32] | None, coarse: AssetMesh, size: int
) -> NDArray[np.float32] | None:
    """The map (size, size, 3) with which `coarse` is shaded as `fine` with its own map `normal`, if it has one.

    `coarse` must have the tangents with which it is written. Returns None where UVs overlap or leave [0, 1]: there a
    texel is not one surface point.
    """
    coverage = rasterize_uvs(coarse.uvs, coarse.faces, size)
    if coarse.uvs.min() < 0 or coarse.uvs.max() > 1 or coverage.overlap > MAX_OVERLAP:
        return None
    world = _world_normals(fine, normal, size).reshape(-1, 3)[coverage.texels]
    t, b, n = _frame(coarse, coverage)
    # The rows of the inverse of (t, b, n) up to a factor, which the normalisation removes.
    det = (t * np.cross(b, n)).sum(-1, keepdims=True)
    local = np.stack([(world * np.cross(*pair)).sum(-1) for pair in ((b, n), (n, t), (t, b))], -1) * np.sign(det)
    length = np.linalg.norm(local, axis=-1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    # A tangent space map cannot represent normals below the coarse surface.
    valid = (length > 1e-9) & (local[:, 2:] > 0) & (det != 0)
    result, known = np.tile(up.astype(np.float32), (size * size, 1)), np.zeros(size * size, bool)
    result[coverage.texels] = np.where(valid, local / np.maximum(length, 1e-9), up)
    known[coverage.texels] = True
    return _unit(dilate(result.reshape(size, size, 3), known.reshape(size, size), _DILATION_STEPS))


def _world_normals(mesh: AssetMesh, normal: NDArray[np.float32] | None, size: int) -> NDArray[np.float32]:
    """Shading normals (size, size, 3) of a mesh over its texture, dilated beyond the borders of its charts."""
    mesh = mesh if normal is None else with_tangents(mesh)
    coverage = rasterize_uvs(mesh.uvs, mesh.faces, size)
    if normal is None:
        shading = coverage.interpolated(mesh.normals, mesh.faces)
    else:
        t, b, n = _frame(mesh, coverage)
        x, y, z = resize(normal, size, size).reshape(-1, 3)[coverage.texels].astype(np.float64).T[..., None]
        shading = x * t + y * b + z * n
    world, known = np.zeros((size * size, 3), np.float32), np.zeros(size * size, bool)
    world[coverage.texels], known[coverage.texels] = _unit(shading), True
    return dilate(world.reshape(size, size, 3), known.reshape(size, size), _DILATION_STEPS)


def _frame(mesh: AssetMesh, coverage: TexelCoverage) -> tuple[Array, Array, Array]:
    """Tangent, bitangent and normal (N, 3) at the texels."""
    assert mesh.tangents is not None
    tangent = coverage.interpolated(mesh.tangents, mesh.faces)
    normal = coverage.interpolated(mesh.normals, mesh.faces)
    return tangent[:, :3], np.cross(normal, tangent[:, :3]) * np.sign(tangent[:, 3:]), normal


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.float32]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit = np.where(length > 1e-9, vectors / np.maximum(length, 1e-9), np.array([0.0, 0.0, 1.0]))
    return np.asarray(unit, np.float32)
