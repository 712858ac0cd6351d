"""Cells: the places at which slowly varying light (irradiance, visibility) is stored.

A cell is a cluster of neighbouring vertices; points of the surface interpolate between the cells of their triangle's
corners. Fine meshes get fewer cells than vertices, so the cost is bounded by `most`, not by the mesh.
"""
# ruff: noqa: TID253

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.surface import Surface


@dataclass(frozen=True, eq=False)
class Cells:
    """Positions and unit normals of C cells, and the cell of each vertex."""

    positions: Float[Tensor, "C 3"]
    normals: Float[Tensor, "C 3"]
    of_vertex: Int[Tensor, " V"]

    def __len__(self) -> int:
        return len(self.positions)


def make_cells(surface: Surface, most: int) -> Cells:
    """Clusters the vertices of a surface into at most about `most` cells, by place and by the octant of the normal."""
    positions, normals = surface.positions, surface.normals
    count = len(positions)
    if count <= most:
        return Cells(positions, normals, torch.arange(count, device=positions.device))
    low = positions.min(dim=0).values
    extent = float((positions.max(dim=0).values - low).max())
    # a surface of area A meets about 2·A/s² voxels of side s
    a, b, c = positions[surface.faces].unbind(1)
    area = float(torch.linalg.cross(b - a, c - a).norm(dim=1).sum()) / 2
    side = max((2 * area / most) ** 0.5, extent * 1e-6)
    labels = torch.zeros(count, dtype=torch.long, device=positions.device)
    for _ in range(8):
        voxel = ((positions - low) / side).long()
        octant = ((normals > 0).long() * torch.tensor([1, 2, 4], device=normals.device)).sum(1, keepdim=True)
        _, labels = torch.unique(torch.cat([voxel, octant], dim=1), dim=0, return_inverse=True)
        if int(labels.max()) < most:
            break
        side *= 1.2
    cells = int(labels.max()) + 1
    sums = torch.zeros(cells, 7, device=positions.device, dtype=positions.dtype)
    one = torch.ones_like(positions[:, :1])
    sums.index_add_(0, labels, torch.cat([positions, normals, one], dim=1))
    # the vertex nearest to the mean stands for the cell: a mean lies off a curved surface, even inside it
    mean = (sums[:, :3] / sums[:, 6:])[labels]
    distance = (positions - mean).square().sum(1)
    order = torch.argsort(distance, stable=True)
    order = order[torch.argsort(labels[order], stable=True)]
    first = torch.ones(count, dtype=torch.bool, device=labels.device)
    first[1:] = labels[order][1:] != labels[order][:-1]
    chosen = order[first]
    return Cells(positions[chosen], normals[chosen], labels)
