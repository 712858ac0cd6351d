"""Irradiance at cells as matrices: one on the light (cosine, visibility, solid angle), one on the other cells."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.operator.irradiance_cache import Cells
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import row_solid_angles, texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.linear_maps import LinearMap
from hir_plugins.reflectance_renderers.transport_ggx.operator.ray_tracer import RayTracer

RAYS_AT_ONCE = 1 << 21


@dataclass(frozen=True, eq=False)
class DiffuseTransport:
    """`irradiance = sky @ light + bounce @ cell_radiance`."""

    sky: LinearMap
    """(C, T): cosine, visibility and solid angle of every texel of the light."""
    bounce: LinearMap
    """(C, C): how much of each cell's hemisphere every other cell fills, times the cosine."""


def diffuse_transport(
    tracer: RayTracer, cells: Cells, face_cells: np.ndarray, height: int, width: int, offset: float
) -> DiffuseTransport:
    """Traces every cell against every texel of a height×width light; `face_cells` is the cell that stands for a face.

    A light of 1 above an open surface gives an irradiance of π to rounding. `offset` lifts ray origins off the facets.
    """
    device = cells.positions.device
    directions = texel_directions(height, width).to(device)
    solid = (row_solid_angles(height, torch.float32, device) * 4 * math.pi / width).repeat_interleave(width)
    sky = torch.zeros(len(cells), height * width, device=device)
    blockers: list[tuple[Tensor, Tensor, Tensor]] = []
    rows = max(1, RAYS_AT_ONCE // (height * width))
    for start in range(0, len(cells), rows):
        part = slice(start, start + rows)
        cosine = cells.normals[part] @ directions.T
        above = cosine > 0
        cell, texel = above.nonzero(as_tuple=True)
        origins = cells.positions[part][cell] + offset * cells.normals[part][cell]
        hits = tracer.closest(origins.cpu().numpy(), directions[texel].cpu().numpy())
        hidden = torch.from_numpy(hits.face >= 0).to(device)
        full = cosine.clamp_min(0) * solid
        # the quadrature of the cosine alone is made exact: its error would colour every texture
        full = full * (math.pi / full.sum(dim=1, keepdim=True).clamp_min(1e-12))
        weight = full[cell, texel]
        sky[part][cell[~hidden], texel[~hidden]] = weight[~hidden]
        blocker = torch.from_numpy(face_cells[hits.face[hits.face >= 0]]).to(device)
        blockers.append((cell[hidden] + start, blocker, weight[hidden]))
    receiver, sender, weight = (torch.cat(parts) for parts in zip(*blockers, strict=True))
    size = len(cells)
    # a product with the transpose of a large row-major matrix is four times slower than with its copy
    return DiffuseTransport(
        LinearMap(sky, sky.T.contiguous()),
        LinearMap(_csr(receiver, sender, weight, size), _csr(sender, receiver, weight, size)),
    )


def _csr(row: Tensor, column: Tensor, weight: Tensor, size: int) -> Tensor:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(Sparse CSR|[Ss]parse invariant).*")
        return torch.sparse_coo_tensor(torch.stack([row, column]), weight, (size, size)).coalesce().to_sparse_csr()
