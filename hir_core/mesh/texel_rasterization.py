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

_BEYOND = 1 << 30
"""The ring of texels that no dilation reaches."""


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
    Only the rings are computed: most texels are in a chart, or in no ring.
    """
    height, width, channels = texture.shape
    ring = _rings(covered)
    values = torch.nn.functional.pad(texture * covered[..., None], (0, 0, 1, 1, 1, 1)).reshape(-1, channels)
    grown = torch.nn.functional.pad((ring > 0) & (ring <= iterations), (1, 1, 1, 1)).reshape(-1).nonzero()[:, 0]
    padded = torch.nn.functional.pad(ring, (1, 1, 1, 1), value=_BEYOND).reshape(-1)
    order = padded[grown].argsort(stable=True)
    grown, number = grown[order], padded[grown][order]
    row = width + 2
    around = torch.tensor([-row - 1, -row, -row + 1, -1, 1, row - 1, row, row + 1], device=texture.device)
    rings, counts = number.unique_consecutive(return_counts=True)
    for each, texels in zip(rings, grown.split(counts.tolist()), strict=True):
        near = texels[:, None] + around
        known = (padded[near] < each)[..., None]
        mean = (values[near] * known).sum(dim=1) / known.sum(dim=1)
        values.index_copy_(0, texels, mean.to(values.dtype))
    found = values.reshape(height + 2, width + 2, channels)[1:-1, 1:-1]
    return torch.where((ring <= iterations)[..., None] & ~covered[..., None], found, texture)


def _rings(covered: Bool[Tensor, "H W"]) -> Int[Tensor, "H W"]:
    """How many steps to one of eight neighbours lead to the nearest covered texel; `_BEYOND` where none is covered."""
    import cv2

    if not bool(covered.any()):
        return torch.full(covered.shape, _BEYOND, dtype=torch.int32, device=covered.device)
    distance = cv2.distanceTransform((~covered).cpu().numpy().astype(np.uint8), cv2.DIST_C, cv2.DIST_MASK_3)
    return torch.from_numpy(np.rint(distance).astype(np.int32)).to(covered.device)
