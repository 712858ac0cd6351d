"""The normals of a fine mesh as a tangent space map for a coarse one that shares its texture coordinates.

A level of detail keeps the UVs of the vertices that stay (`hir_exporters.mesh.simplification`), so that one texel is
one place on
both meshes: no rays are needed. Frames are those that shaders build: interpolated normal and MikkTSpace tangent, not
normalised, and `cross(normal, tangent) * sign`.
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

OVERLAP: Final = 0.01
"""Share of texels that may be claimed twice; above it one map cannot serve all places."""

_MARGIN: Final = 8  # texels past the border of a chart, for filters and mipmaps


def baked_normals(
    fine: AssetMesh, normal: NDArray[np.float32] | None, coarse: AssetMesh, size: int
) -> NDArray[np.float32] | None:
    """The map (size, size, 3) with which `coarse` shades as `fine` does with its own map `normal`, or with none.

    `coarse` must have the tangents it is written with. None where texture coordinates overlap or leave [0, 1]: there
    a texel is no one place.
    """
    below = rasterize_uvs(coarse.uvs, coarse.faces, size)
    if coarse.uvs.min() < 0 or coarse.uvs.max() > 1 or below.overlap > OVERLAP:
        return None
    world = _world_normals(fine, normal, size).reshape(-1, 3)[below.texels]
    t, b, n = _frame(coarse, below)
    # the rows of the inverse of (t, b, n), to a factor that the length takes away
    det = (t * np.cross(b, n)).sum(-1, keepdims=True)
    local = np.stack([(world * np.cross(*pair)).sum(-1) for pair in ((b, n), (n, t), (t, b))], -1) * np.sign(det)
    length = np.linalg.norm(local, axis=-1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    # what points below the coarse surface cannot be said in a map
    fits = (length > 1e-9) & (local[:, 2:] > 0) & (det != 0)
    result, known = np.tile(up.astype(np.float32), (size * size, 1)), np.zeros(size * size, bool)
    result[below.texels] = np.where(fits, local / np.maximum(length, 1e-9), up)
    known[below.texels] = True
    return _unit(dilate(result.reshape(size, size, 3), known.reshape(size, size), _MARGIN))


def _world_normals(mesh: AssetMesh, normal: NDArray[np.float32] | None, size: int) -> NDArray[np.float32]:
    """Shading normals (size, size, 3) of a mesh over its texture, grown past the borders of its charts."""
    mesh = mesh if normal is None else with_tangents(mesh)
    cover = rasterize_uvs(mesh.uvs, mesh.faces, size)
    if normal is None:
        shading = cover.interpolated(mesh.normals, mesh.faces)
    else:
        t, b, n = _frame(mesh, cover)
        x, y, z = resize(normal, size, size).reshape(-1, 3)[cover.texels].astype(np.float64).T[..., None]
        shading = x * t + y * b + z * n
    world, known = np.zeros((size * size, 3), np.float32), np.zeros(size * size, bool)
    world[cover.texels], known[cover.texels] = _unit(shading), True
    return dilate(world.reshape(size, size, 3), known.reshape(size, size), _MARGIN)


def _frame(mesh: AssetMesh, cover: TexelCoverage) -> tuple[Array, Array, Array]:
    """Tangent, bitangent and normal (N, 3) at the texels."""
    assert mesh.tangents is not None
    tangent = cover.interpolated(mesh.tangents, mesh.faces)
    normal = cover.interpolated(mesh.normals, mesh.faces)
    return tangent[:, :3], np.cross(normal, tangent[:, :3]) * np.sign(tangent[:, 3:]), normal


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.float32]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit = np.where(length > 1e-9, vectors / np.maximum(length, 1e-9), np.array([0.0, 0.0, 1.0]))
    return np.asarray(unit, np.float32)
