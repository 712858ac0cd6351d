"""Texels of an atlas as points of the surface, and the dilation of textures beyond the charts' borders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from hir_exporters.textures.uv_rasterization import rasterize_triangles
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.errors import StageError
from hir_core.scene import Mesh


@dataclass(frozen=True, eq=False)
class TexelSurface:
    """The N texels whose centres lie in a chart, row by row: `texture[covered]` is in the order of the other fields."""

    covered: Bool[Tensor, "H W"]
    face: Int[Tensor, " N"]
    barycentric: Float[Tensor, "N 3"]
    """Not negative, sum 1."""
    position: Float[Tensor, "N 3"]
    normal: Float[Tensor, "N 3"]
    """Unit; the interpolated vertex normal."""
    overlaps: int
    """Number of texels inside more than one triangle; 0 for a valid atlas."""


def texel_surface(mesh: Mesh, size: int | tuple[int, int]) -> TexelSurface:
    """Rasterises the charts of `mesh` into a texture of `size` (height, width); texel centres lie at .5."""
    if mesh.uvs is None or mesh.topology.uv_faces is None:
        raise StageError("the mesh has no texture coordinates; unwrap it first (hir_core.stages.atlas.unwrap)")
    height, width = (size, size) if isinstance(size, int) else size
    uvs = mesh.uvs.detach().cpu().numpy().astype(np.float64)
    corners = uvs[mesh.topology.uv_faces.cpu().numpy()] * [width, height]
    owner, barycentric, overlaps = rasterize_triangles(corners, height, width, single=True)
    covered = owner >= 0
    face = torch.from_numpy(owner[covered]).long().to(mesh.positions.device)
    weights = torch.from_numpy(barycentric[covered]).to(mesh.positions)
    normals = mesh.normals
    position = interpolate(mesh.positions, mesh.faces, face, weights)
    normal = interpolate(normals, mesh.faces, face, weights)
    length = torch.linalg.vector_norm(normal, dim=1, keepdim=True)
    flat = normals[mesh.faces[face, 0]]  # the vertex normals of a folded face cancel
    normal = torch.where(length > 1e-6, normal / length.clamp_min(1e-6), flat)
    mask = torch.from_numpy(covered).to(mesh.positions.device)
    return TexelSurface(mask, face, weights, position, normal, overlaps)


def interpolate(
    values: Float[Tensor, "V C"], faces: Int[Tensor, "F 3"], face: Int[Tensor, " N"], weights: Float[Tensor, "N 3"]
) -> Float[Tensor, "N C"]:
    """Values of vertices at points of faces, given by their barycentric weights."""
    first, second, third = faces.unbind(1)
    total = values[first[face]] * weights[:, :1]
    total = total + values[second[face]] * weights[:, 1:2]
    return total + values[third[face]] * weights[:, 2:]


def texture_of_vertices(mesh: Mesh, values: Float[Tensor, "V C"], surface: TexelSurface) -> Float[Tensor, "H W C"]:
    """A texture of values that are linear on each face; 0 outside the charts."""
    texture = values.new_zeros((*surface.covered.shape, values.shape[1]))
    texture[surface.covered] = interpolate(values, mesh.faces, surface.face, surface.barycentric)
    return texture


def dilate(texture: Float[Tensor, "H W C"], covered: Bool[Tensor, "H W"], iterations: int) -> Float[Tensor, "H W C"]:
    """Extends charts by one ring of texels in each iteration, so that bilinear filtering at seams reads the chart.

    Each new texel is the mean of its known neighbours. Differentiable in `texture`; covered texels stay as they are.
    """
    values = (texture * covered[..., None]).permute(2, 0, 1)
    known = covered.to(texture.dtype)[None]
    for _ in range(iterations):
        total, count = _neighbours(values), _neighbours(known)
        mean = total / count.clamp_min(1)
        values = torch.where(known > 0, values, mean)
        known = ((known + count) > 0).to(texture.dtype)
    filled = torch.where(known[..., None][0] > 0, values.permute(1, 2, 0), texture)
    return torch.where(covered[..., None], texture, filled)


def _neighbours(image: Float[Tensor, "C H W"]) -> Float[Tensor, "C H W"]:
    """Sum over the eight neighbours, 0 beyond the border."""
    padded = torch.nn.functional.pad(image, (1, 1, 1, 1))
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return rows[:, :, :-2] + rows[:, :, 1:-1] + rows[:, :, 2:] - image
