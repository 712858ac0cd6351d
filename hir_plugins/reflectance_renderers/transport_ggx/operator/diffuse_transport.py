"""Irradiance of cache cells as two matrices: from the light (cosine, visibility, solid angle) and from other cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hir_core.optimization.linear_maps import LinearMap, compressed_sum
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.irradiance_cache import IrradianceCache
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import row_solid_angles, texel_directions

RAYS_PER_CHUNK = 1 << 21


@dataclass(frozen=True, eq=False)
class DiffuseTransport:
    """`irradiance = sky @ light + bounce @ cell_radiance`."""

    sky: LinearMap
    """(C, T): cosine, visibility and solid angle of every texel of the light."""
    bounce: LinearMap
    """(C, C): cosine-weighted solid angle of every other cell in each cell's hemisphere."""


def diffuse_transport(
    tracer: RayTracer, cache: IrradianceCache, face_cells: np.ndarray, height: int, width: int, offset: float
) -> DiffuseTransport:
    """Traces a ray from every cell to every texel of a height×width light; `face_cells` is the cell of each face.

    A radiance of 1 above an unoccluded cell gives an irradiance of π to rounding. Ray origins are moved by `offset`
    along the normal.
    """
    device = cache.positions.device
    directions = texel_directions(height, width).to(device)
    solid = (row_solid_angles(height, torch.float32, device) * 4 * math.pi / width).repeat_interleave(width)
    sky = torch.zeros(len(cache), height * width, device=device)
    blockers: list[tuple[Tensor, Tensor, Tensor]] = []
    rows = max(1, RAYS_PER_CHUNK // (height * width))
    for start in range(0, len(cache), rows):
        part = slice(start, start + rows)
        cosine = cache.normals[part] @ directions.T
        above = cosine > 0
        cell, texel = above.nonzero(as_tuple=True)
        origins = cache.positions[part][cell] + offset * cache.normals[part][cell]
        hits = tracer.closest(origins.cpu().numpy(), directions[texel].cpu().numpy())
        occluded = torch.from_numpy(hits.face >= 0).to(device)
        full = cosine.clamp_min(0) * solid
        # normalised so that the cosine integrates to π exactly: a quadrature error would tint every texture
        full = full * (math.pi / full.sum(dim=1, keepdim=True).clamp_min(1e-12))
        weight = full[cell, texel]
        sky[part][cell[~occluded], texel[~occluded]] = weight[~occluded]
        blocker = torch.from_numpy(face_cells[hits.face[hits.face >= 0]]).to(device)
        blockers.append((cell[occluded] + start, blocker, weight[occluded]))
    receiver, sender, weight = (torch.cat(parts) for parts in zip(*blockers, strict=True))
    size = len(cache)
    # multiplying by a transposed view of a large row-major matrix is four times slower than by a copy
    return DiffuseTransport(
        LinearMap(sky, sky.T.contiguous()),
        LinearMap(
            compressed_sum(receiver, sender, weight, (size, size)),
            compressed_sum(sender, receiver, weight, (size, size)),
        ),
    )
