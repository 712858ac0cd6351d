"""The irradiance cache: the surface points at which slowly varying light (irradiance, visibility) is stored.

A cache cell is a cluster of neighbouring vertices. Surface points interpolate between the cells of their triangle's
corners. A fine mesh has fewer cells than vertices, so `max_cells` bounds the cost, not the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface

MAX_VOXEL_LEVELS = 4
"""Levels of voxels: each has half the side of the one before, so the smallest has an eighth of the first."""
MAX_SIZE_ITERATIONS = 8
"""Attempts to find a voxel side that keeps to the number of cells."""
BISECTION_STEPS = 10
"""Bisections of the threshold on cancelling normals, above which a voxel is split."""
MIN_LOG10_CANCELLATION = -9.0
"""Lower end of that threshold's range, as log10; the normals of a whole sphere cancel by 1."""
VOXEL_INDEX_BITS = 19
"""Bits of a voxel's index along one axis."""
MIN_VOXEL_SIDE = 2e-5
"""Smallest voxel side, as a fraction of the object's extent, so that indices fit `VOXEL_INDEX_BITS`."""


@dataclass(frozen=True, eq=False)
class IrradianceCache:
    """Positions and unit normals of C cache cells, and the cell of each vertex."""

    positions: Float[Tensor, "C 3"]
    normals: Float[Tensor, "C 3"]
    of_vertex: Int[Tensor, " V"]

    def __len__(self) -> int:
        return len(self.positions)


def build_irradiance_cache(surface: Surface, max_cells: int) -> IrradianceCache:
    """Clusters the vertices of a surface into at most about `max_cells` cells, by position and by normal.

    Voxels use up part of `max_cells`. The remaining cells go to voxels where large areas curve strongly, because
    irradiance changes with the normal; one triangle of a coarse mesh may turn by a right angle.
    """
    count = len(surface.positions)
    if count <= max_cells:
        return IrradianceCache(surface.positions, surface.normals, torch.arange(count, device=surface.positions.device))
    low = surface.positions.min(dim=0).values
    extent = float((surface.positions.max(dim=0).values - low).max())
    a, b, c = surface.positions[surface.faces].unbind(1)
    twice = torch.linalg.cross(b - a, c - a).norm(dim=1)
    share = twice.new_zeros(count).index_add_(0, surface.faces.reshape(-1), twice.repeat_interleave(3))
    weighted = surface.normals * (share / share.sum().clamp_min(1e-30))[:, None]
    # a surface of area A meets about 2·A/s² voxels of side s
    side = max((float(twice.sum()) / max_cells) ** 0.5, extent * MIN_VOXEL_SIDE)
    labels = torch.zeros(count, dtype=torch.long, device=low.device)
    for _ in range(MAX_SIZE_ITERATIONS):
        voxel_positions = ((surface.positions - low) / side).nan_to_num(0)
        labels = _clusters(voxel_positions, surface.normals, weighted, 1.0)
        if int(labels.max()) < max_cells:
            break
        side *= 1.2
    else:
        return _cells(surface, labels)
    high, low_log10 = 0.0, MIN_LOG10_CANCELLATION
    for _ in range(BISECTION_STEPS):
        middle = (high + low_log10) / 2
        candidate = _clusters(voxel_positions, surface.normals, weighted, 10.0**middle)
        if int(candidate.max()) < max_cells:
            high, labels = middle, candidate
        else:
            low_log10 = middle
    return _cells(surface, labels)


def _clusters(
    positions: Float[Tensor, "V 3"], normals: Float[Tensor, "V 3"], weighted: Float[Tensor, "V 3"], threshold: float
) -> Int[Tensor, " V"]:
    """The cluster of each vertex: voxels of side 1, each divided by the octant of the normal.

    A voxel is split into eight where its `weighted` normals (each as long as its share of the area) cancel by more than
    `threshold`, and its parts again, down to `MAX_VOXEL_LEVELS`.
    """
    key = torch.zeros(len(positions), dtype=torch.long, device=positions.device)
    is_final = torch.zeros_like(key, dtype=torch.bool)
    octant = ((normals > 0).long() * torch.tensor([1, 2, 4], device=normals.device)).sum(1)
    length = weighted.norm(dim=1)
    for level in range(MAX_VOXEL_LEVELS):
        # a voxel lies inside one voxel of the level above, so the vertices of a final cluster stay together
        voxel = (positions * 2**level).long().clamp(0, (1 << VOXEL_INDEX_BITS) - 1)
        own = (
            (((level << 3) + octant << VOXEL_INDEX_BITS) + voxel[:, 0] << VOXEL_INDEX_BITS) + voxel[:, 1]
            << VOXEL_INDEX_BITS
        ) + voxel[:, 2]
        key = torch.where(is_final, key, own)
        if level < MAX_VOXEL_LEVELS - 1:
            _, labels, number = torch.unique(key, return_inverse=True, return_counts=True)
            total = normals.new_zeros(len(number), 3).index_add_(0, labels, weighted).norm(dim=1)
            whole = normals.new_zeros(len(number)).index_add_(0, labels, length)
            is_final = is_final | (whole - total <= threshold)[labels]
    return torch.unique(key, return_inverse=True)[1]


def _cells(surface: Surface, labels: Int[Tensor, " V"]) -> IrradianceCache:
    """Each cell takes the vertex nearest to its mean: the mean itself does not lie on a curved surface."""
    positions, count = surface.positions, len(surface.positions)
    sums = torch.zeros(int(labels.max()) + 1, 4, device=positions.device, dtype=positions.dtype)
    sums.index_add_(0, labels, torch.cat([positions, torch.ones_like(positions[:, :1])], dim=1))
    mean = (sums[:, :3] / sums[:, 3:])[labels]
    order = torch.argsort((positions - mean).square().sum(1), stable=True)
    order = order[torch.argsort(labels[order], stable=True)]
    first = torch.ones(count, dtype=torch.bool, device=labels.device)
    first[1:] = labels[order][1:] != labels[order][:-1]
    chosen = order[first]
    return IrradianceCache(positions[chosen], surface.normals[chosen], labels)
