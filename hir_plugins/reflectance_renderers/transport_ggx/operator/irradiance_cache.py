"""Cells: the places at which slowly varying light (irradiance, visibility) is stored.

A cell is a cluster of neighbouring vertices; points of the surface interpolate between the cells of their triangle's
corners. Fine meshes get fewer cells than vertices, so the cost is bounded by `most`, not by the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface

LEVELS = 4
"""Cells are cut to an eighth of their side at most."""
ROUNDS = 8
HALVINGS = 10
"""Of the range in which the largest turn of a cell is sought."""
LEAST_TURN = -9.0
"""Its lowest logarithm (10), of 1 for a whole sphere."""
BITS = 19
"""Of a voxel's number along an axis."""
SMALLEST = 2e-5
"""Side of a cell, as a fraction of the object's extent: voxels of the last level are numbered in `BITS`."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Positions and unit normals of C cells, and the cell of each vertex."""

    positions: Float[Tensor, "C 3"]
    normals: Float[Tensor, "C 3"]
    of_vertex: Int[Tensor, " V"]

    def __len__(self) -> int:
        return len(self.positions)


def make_cells(surface: Surface, most: int) -> Cells:
    """Clusters the vertices of a surface into at most about `most` cells, by place and by normal.

    What places leave of `most` is spent where most surface turns most: irradiance changes with the normal, and one
    triangle of a coarse mesh may turn by a right angle.
    """
    count = len(surface.positions)
    if count <= most:
        return Cells(surface.positions, surface.normals, torch.arange(count, device=surface.positions.device))
    low = surface.positions.min(dim=0).values
    extent = float((surface.positions.max(dim=0).values - low).max())
    a, b, c = surface.positions[surface.faces].unbind(1)
    twice = torch.linalg.cross(b - a, c - a).norm(dim=1)
    share = twice.new_zeros(count).index_add_(0, surface.faces.reshape(-1), twice.repeat_interleave(3))
    weighted = surface.normals * (share / share.sum().clamp_min(1e-30))[:, None]
    # a surface of area A meets about 2·A/s² voxels of side s
    side = max((float(twice.sum()) / most) ** 0.5, extent * SMALLEST)
    labels = torch.zeros(count, dtype=torch.long, device=low.device)
    for _ in range(ROUNDS):
        places = ((surface.positions - low) / side).nan_to_num(0)
        labels = _clusters(places, surface.normals, weighted, 1.0)
        if int(labels.max()) < most:
            break
        side *= 1.2
    else:
        return _cells(surface, labels)
    easy, hard = 0.0, LEAST_TURN
    for _ in range(HALVINGS):
        middle = (easy + hard) / 2
        found = _clusters(places, surface.normals, weighted, 10.0**middle)
        if int(found.max()) < most:
            easy, labels = middle, found
        else:
            hard = middle
    return _cells(surface, labels)


def _clusters(
    places: Float[Tensor, "V 3"], normals: Float[Tensor, "V 3"], weighted: Float[Tensor, "V 3"], turn: float
) -> Int[Tensor, " V"]:
    """The cluster of each vertex: voxels of side 1 and octants of normals, the voxels cut into eight, again and again,
    where `weighted` normals (each as long as its share of the surface) cancel by more than `turn`.
    """
    key = torch.zeros(len(places), dtype=torch.long, device=places.device)
    settled = torch.zeros_like(key, dtype=torch.bool)
    octant = ((normals > 0).long() * torch.tensor([1, 2, 4], device=normals.device)).sum(1)
    length = weighted.norm(dim=1)
    for level in range(LEVELS):
        # voxels of a level lie in one of the level above: vertices that settle together stay together
        voxel = (places * 2**level).long().clamp(0, (1 << BITS) - 1)
        own = ((((level << 3) + octant << BITS) + voxel[:, 0] << BITS) + voxel[:, 1] << BITS) + voxel[:, 2]
        key = torch.where(settled, key, own)
        if level < LEVELS - 1:
            _, labels, number = torch.unique(key, return_inverse=True, return_counts=True)
            total = normals.new_zeros(len(number), 3).index_add_(0, labels, weighted).norm(dim=1)
            whole = normals.new_zeros(len(number)).index_add_(0, labels, length)
            settled = settled | (whole - total <= turn)[labels]
    return torch.unique(key, return_inverse=True)[1]


def _cells(surface: Surface, labels: Int[Tensor, " V"]) -> Cells:
    """The vertex nearest to the mean stands for its cell: a mean lies off a curved surface, even inside it."""
    positions, count = surface.positions, len(surface.positions)
    sums = torch.zeros(int(labels.max()) + 1, 4, device=positions.device, dtype=positions.dtype)
    sums.index_add_(0, labels, torch.cat([positions, torch.ones_like(positions[:, :1])], dim=1))
    mean = (sums[:, :3] / sums[:, 3:])[labels]
    order = torch.argsort((positions - mean).square().sum(1), stable=True)
    order = order[torch.argsort(labels[order], stable=True)]
    first = torch.ones(count, dtype=torch.bool, device=labels.device)
    first[1:] = labels[order][1:] != labels[order][:-1]
    chosen = order[first]
    return Cells(positions[chosen], surface.normals[chosen], labels)
