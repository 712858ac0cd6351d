"""Which point of the surface each texel of an atlas is, and how textures go on where no surface or no view is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.errors import StageError
from hir_core.scene import Mesh

_CANDIDATES = 500_000
"""Pairs of face and texel tested at once: bounds memory at about 100 MB."""
_EDGE = 1e-6
"""Barycentric slack, in which a texel centre on the edge between two faces belongs to at least one."""


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
    """Texels that more than one chart claims; 0 for a proper atlas."""


def texel_surface(mesh: Mesh, size: int | tuple[int, int]) -> TexelSurface:
    """Rasterises the charts of `mesh` into a texture of `size` (height, width); texel centres lie at .5."""
    if mesh.uvs is None or mesh.topology.uv_faces is None:
        raise StageError("the mesh has no texture coordinates; unwrap it first (hir_core.stages.atlas.unwrap)")
    height, width = (size, size) if isinstance(size, int) else size
    uvs = mesh.uvs.detach().cpu().numpy().astype(np.float64)
    corners = uvs[mesh.topology.uv_faces.cpu().numpy()] * [width, height]
    owner, barycentric, overlaps = rasterize(corners, height, width)
    covered = owner >= 0
    face = torch.from_numpy(owner[covered]).long().to(mesh.positions.device)
    weights = torch.from_numpy(barycentric[covered]).to(mesh.positions)
    normals = mesh.normals
    position = interpolate(mesh.positions, mesh.faces, face, weights)
    normal = interpolate(normals, mesh.faces, face, weights)
    length = torch.linalg.vector_norm(normal, dim=1, keepdim=True)
    flat = normals[mesh.faces[face, 0]]  # opposite normals of a folded face cancel
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


def rasterize(
    corners: NDArray[np.float64], height: int, width: int
) -> tuple[NDArray[np.int64], NDArray[np.float32], int]:
    """Owner (H, W) of each texel (−1: none), its barycentrics (H, W, 3) in it, and how many texels were claimed twice.

    `corners` (F, 3, 2) are in texels. A centre inside a triangle or on its edge is always claimed.
    """
    owner = np.full(height * width, -1, dtype=np.int64)
    barycentric = np.zeros((height * width, 3), dtype=np.float32)
    claims = np.zeros(height * width, dtype=np.uint8)
    boxes = _boxes(corners, height, width)
    planes = _barycentric_planes(corners)
    counts = boxes[:, 2] * boxes[:, 3]
    counts[~np.isfinite(planes).all(axis=1)] = 0
    order = np.flatnonzero(counts)
    ends = np.cumsum(counts[order])
    start = 0
    while start < len(order):
        before = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, before + _CANDIDATES, side="right")), start + 1)
        faces = order[start:stop]
        face, texel, weights = _inside(faces, counts[faces], boxes, planes, width)
        owner[texel] = face
        barycentric[texel] = weights
        # a centre on a shared edge has two faces but one chart: only claims from strictly inside count as overlap
        strict = texel[(weights[:, 0] > 1e-3) & (weights[:, 1] > 1e-3) & (weights[:, 2] > 1e-3)]
        twice, times = np.unique(strict, return_counts=True)
        claims[twice] = np.minimum(claims[twice] + np.minimum(times, 2), 2)
        start = stop
    return owner.reshape(height, width), barycentric.reshape(height, width, 3), int((claims > 1).sum())


def _boxes(corners: NDArray[np.float64], height: int, width: int) -> NDArray[np.int64]:
    """(F, 4): first column and row of the texel centres in each triangle's box, and numbers of columns and rows."""
    limit = np.array([width, height])
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5 - _EDGE), 0, limit)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5 + _EDGE), -1, limit - 1)
    return np.concatenate([low, np.maximum(high - low + 1, 0)], axis=1).astype(np.int64)


def _barycentric_planes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F, 6): second and third barycentric of a texel centre as `p + q·column + r·row`; not finite without area."""
    a, ab, ac = corners[:, 0] - 0.5, corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    area = np.where(np.abs(area) > 1e-12, area, np.nan)
    second_x, second_y = ac[:, 1] / area, -ac[:, 0] / area
    third_x, third_y = -ab[:, 1] / area, ab[:, 0] / area
    second = -(second_x * a[:, 0] + second_y * a[:, 1])
    third = -(third_x * a[:, 0] + third_y * a[:, 1])
    return np.stack([second, second_x, second_y, third, third_x, third_y], axis=1)


def _inside(
    faces: NDArray[np.int64],
    counts: NDArray[np.int64],
    boxes: NDArray[np.int64],
    planes: NDArray[np.float64],
    width: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Face, texel and barycentrics (N, 3) of all texel centres in the boxes of `faces` that lie in the triangle."""
    local = np.repeat(np.arange(len(faces)), counts)
    offset = np.arange(len(local)) - np.repeat(np.cumsum(counts) - counts, counts)
    first_column, first_row, columns = boxes[faces, 0], boxes[faces, 1], boxes[faces, 2]
    down = offset // columns[local]
    column = offset - down * columns[local] + first_column[local]
    row = down + first_row[local]
    p = [planes[faces, i][local] for i in range(6)]
    second = p[0] + p[1] * column + p[2] * row
    third = p[3] + p[4] * column + p[5] * row
    first = 1 - second - third
    inside = np.flatnonzero((first >= -_EDGE) & (second >= -_EDGE) & (third >= -_EDGE))
    weights = np.clip(np.stack([first[inside], second[inside], third[inside]], axis=1), 0, 1)
    weights /= (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]
    return faces[local[inside]], row[inside] * width + column[inside], weights


def dilate(texture: Float[Tensor, "H W C"], covered: Bool[Tensor, "H W"], iterations: int) -> Float[Tensor, "H W C"]:
    """Carries charts outwards, one ring of texels an iteration, so that bilinear filtering at seams reads the chart.

    Differentiable in `texture`; covered texels are returned as they are.
    """
    values = (texture * covered[..., None]).permute(2, 0, 1)
    known = covered.to(texture.dtype)[None]
    for _ in range(iterations):
        total, count = _neighbours(values), _neighbours(known)
        grown = total / count.clamp_min(1)
        values = torch.where(known > 0, values, grown)
        known = ((known + count) > 0).to(texture.dtype)
    filled = torch.where(known[..., None][0] > 0, values.permute(1, 2, 0), texture)
    return torch.where(covered[..., None], texture, filled)


def _neighbours(image: Float[Tensor, "C H W"]) -> Float[Tensor, "C H W"]:
    """Sum over the eight neighbours; nothing lies beyond the border."""
    padded = torch.nn.functional.pad(image, (1, 1, 1, 1))
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return rows[:, :, :-2] + rows[:, :, 1:-1] + rows[:, :, 2:] - image
