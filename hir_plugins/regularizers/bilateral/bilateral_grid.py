"""Bilateral means of any number of samples in linear time, by an adaptive bilateral grid.

A mean over all pairs costs n². Here the samples q are collected in cells: cubes of space, each divided again by the
guide, such as the albedo. The mean at a sample p sums over the cells of all cubes within the cutoff. The kernel is
expanded to first order about a cell's centroid x̄, which gives weights `k(p, x̄)·(1 + (p − x̄)·(q − x̄))`: the cell's
number of samples, their mean value and the covariance of value and feature are all that is needed. The number of cells
of a sum depends on the widths of the kernel and on the guide nearby, not on n. Where every sample has a cell of its own
only the cutoff is an approximation. `bilateral_pairs.py` has the sum over all pairs and the error bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.errors import StageError

_PAIRS = 1_000_000
"""Pairs of sample and cell evaluated at once: bounds memory at about 20 MB, which caches partly hold."""
_ROWS = 256
"""Most samples of one block that share a list of cells in one evaluation."""
_ROW_STEP = 32
"""Tiles are padded to multiples of so many samples, and those with equal numbers evaluated together."""
_BLOCK = 2
"""Cubes along the side of a block of samples that share a list of near cubes."""
_STEPS_PER_CHANNEL = 1 << 14
"""Largest number of grid steps along one channel of the guide."""


@dataclass(frozen=True, eq=False)
class Cubes:
    """Fixed samples sorted into cubes, and for each block of 2³ cubes the cubes within the cutoff."""

    positions: Float[Tensor, "N 3"]
    """In σ, in the order of the samples."""
    cube: Int[Tensor, " N"]
    """Of each sample."""
    block: Int[Tensor, " N"]
    """Of each sample."""
    order: Int[Tensor, " N"]
    """Samples by block."""
    first: Int[Tensor, " B+1"]
    """Where each block begins in `order`."""
    near: Int[Tensor, " M"]
    """Cubes within the cutoff, block after block."""
    near_first: Int[Tensor, " B+1"]
    """Where each block begins in `near`."""


@dataclass(frozen=True, eq=False)
class GridCells:
    """Samples that share a cube and a step of the guide, cube after cube."""

    of_sample: Int[Tensor, " N"]
    count: Float[Tensor, " C"]
    feature: Float[Tensor, "C F"]
    """Centroid of position and guide."""
    value: Float[Tensor, "C D"]
    """Mean."""
    slope: Float[Tensor, "C F D"]
    """Covariance of feature and value."""
    first: Int[Tensor, " S+1"]
    """Where each cube's cells begin."""


@dataclass(frozen=True, eq=False)
class Tile:
    """T lists of samples, each with the cells of its sums; padded to lists of equal length."""

    samples: Int[Tensor, "T R"]
    is_sample: Bool[Tensor, "T R"]
    """False where a list is padded, with its first sample."""
    cells: Int[Tensor, "T W"]
    is_cell: Bool[Tensor, "T W"]
    """False where a list is padded, with cell 0."""


def cubes_of(positions: Float[Tensor, "N 3"], cutoff: float, edge: float) -> Cubes:
    """Sorts samples (in σ) into cubes of `edge`; near a block are the cubes with bounds within `cutoff` of its own."""
    from scipy.spatial import cKDTree

    points = positions.detach().cpu().double().numpy()
    if not np.isfinite(points).all():
        raise StageError("the mesh has vertices that are not finite; repair it first")
    index = np.floor((points - points.min(axis=0, initial=0.0)) / edge)
    cube, _, _, cube_low, cube_high = _grouped(index, points)
    block, order, first, low, high = _grouped(index // _BLOCK, points)
    centres = [cKDTree((a + b) / 2) for a, b in ((low, high), (cube_low, cube_high))]
    reach = cutoff + 0.5 * np.sqrt(3) * (_BLOCK + 1) * edge
    near = centres[0].sparse_distance_matrix(centres[1], reach * (1 + 1e-9), output_type="ndarray")
    row, column = near["i"].astype(np.int64), near["j"].astype(np.int64)  # block, cube
    gap = np.maximum(np.maximum(low[row] - cube_high[column], cube_low[column] - high[row]), 0)
    within = (gap**2).sum(axis=1) <= cutoff**2
    row, column = row[within], column[within]
    sorted_ = np.lexsort((column, row))
    near_first = np.searchsorted(row[sorted_], np.arange(len(low) + 1))
    parts: list[NDArray[np.int64]] = [cube, block, order, first, column[sorted_], near_first]
    return Cubes(positions.detach(), *(torch.from_numpy(p).to(positions.device) for p in parts))


def _grouped(
    index: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Group of each point by its index, points by group, where each group begins, and its bounds."""
    groups, of_point = np.unique(index, axis=0, return_inverse=True)
    of_point = of_point.reshape(-1)
    order = np.argsort(of_point, kind="stable")
    first = np.searchsorted(of_point[order], np.arange(len(groups) + 1))
    low, high = (reduce.reduceat(points[order], first[:-1], axis=0) for reduce in (np.minimum, np.maximum))
    return of_point, order, first, low, high


def cells_of(cubes: Cubes, guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"], edge: float) -> GridCells:
    """Divides each cube by the guide in steps of `edge`; centroids and means are differentiable, membership is not."""
    with torch.no_grad():
        # non-finite values stay in the sums, but do not choose a cell
        step = torch.floor(torch.nan_to_num(guide.detach().double(), 0.0, 0.0, 0.0) / edge)
        step -= step.amin(0) if len(step) else 0
        if bool((step >= _STEPS_PER_CHANNEL).any()):
            raise StageError(
                "a guiding map of the bilateral term spans more than 16000 of its widths; give it a larger sigma"
            )
        key = cubes.cube
        for channel in step.long().unbind(1):
            _, key = torch.unique(key * _STEPS_PER_CHANNEL + channel, return_inverse=True)
        count = int(key.max()) + 1 if len(key) else 0
        member = torch.empty(count, dtype=torch.long, device=key.device)
        member[key] = torch.arange(len(key), device=key.device)
        of_cell = cubes.cube[member]
    number = guide.new_zeros(count).index_add(0, key, torch.ones_like(guide[:, 0]))

    def mean(of: Tensor) -> Tensor:
        # relative to a member: a mean of equal numbers is exactly that number
        base = of[member].detach()
        return base + of.new_zeros(count, of.shape[1]).index_add(0, key, of - base[key]) / number[:, None].to(of)

    feature = torch.cat([cubes.positions.to(guide.dtype), guide], dim=1)
    centroid, middle = mean(feature), mean(values)
    covariance = (feature - centroid[key])[:, :, None] * (values - middle[key])[:, None]
    slope = mean(covariance.flatten(1)).unflatten(1, covariance.shape[1:])
    cubes_in_all = int(cubes.cube.max()) + 1 if count else 0
    first = torch.searchsorted(of_cell, torch.arange(cubes_in_all + 1, device=key.device))
    return GridCells(key, number, centroid, middle, slope, first)


def tiles_of(cubes: Cubes, cells: GridCells) -> Iterator[Tile]:
    """All samples, each in one tile; lists of similar length are evaluated together."""
    device = cells.count.device
    order, first = cubes.order.cpu().numpy(), cubes.first.cpu().numpy()
    near, near_first = cubes.near.cpu().numpy(), cubes.near_first.cpu().numpy()
    cell_first = cells.first.cpu().numpy()
    size = np.diff(cell_first)
    before = np.concatenate([[0], np.cumsum(size[near])])
    width = before[near_first[1:]] - before[near_first[:-1]]
    most = np.clip(_PAIRS // np.maximum(width, 1), 1, _ROWS)
    per_block = -(-np.diff(first) // most)
    most = -(-np.diff(first) // np.maximum(per_block, 1))  # lists of equal length need the least padding
    block = np.repeat(np.arange(len(width)), per_block)
    begin = first[block] + most[block] * (
        np.arange(len(block)) - np.repeat(np.cumsum(per_block) - per_block, per_block)
    )
    rows = np.minimum(first[block + 1] - begin, most[block])
    wanted = -(-rows // _ROW_STEP) * _ROW_STEP
    by_size = np.lexsort((width[block], wanted))
    start = 0
    while start < len(by_size):
        stop = _chunk_end(by_size, start, wanted, width[block])
        tile = by_size[start:stop]
        slot = np.arange(wanted[tile[-1]])
        is_sample = slot < rows[tile, None]
        row = order[begin[tile, None] + np.where(is_sample, slot, 0)]
        listed, is_cell = _cells_of_blocks(
            block[tile], near, near_first, cell_first, size, int(width[block[tile]].max())
        )
        yield Tile(*(torch.from_numpy(part).to(device) for part in (row, is_sample, listed, is_cell)))
        start = stop


def _chunk_end(by_size: NDArray[np.int64], start: int, rows: NDArray[np.int64], width: NDArray[np.int64]) -> int:
    """The end of the tiles of one number of rows that fit into one evaluation, with the features of their cells."""
    same = rows[by_size[start]]
    high = int(np.searchsorted(rows[by_size], same, side="right"))
    widths = width[by_size[start:high]]
    pairs = np.arange(1, len(widths) + 1) * widths * (same + 32)
    return start + max(1, int(np.searchsorted(pairs, _PAIRS, side="right")))


def _cells_of_blocks(
    blocks: NDArray[np.int64],
    near: NDArray[np.int64],
    near_first: NDArray[np.int64],
    cell_first: NDArray[np.int64],
    size: NDArray[np.int64],
    width: int,
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Cells (T W) near each of the blocks, padded with cell 0, and which are no padding."""
    cubes = [near[near_first[b] : near_first[b + 1]] for b in blocks]
    cube = np.concatenate(cubes)
    length = size[cube]
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    flat = np.repeat(cell_first[cube], length) + offset
    tile = np.repeat(np.repeat(np.arange(len(blocks)), [len(c) for c in cubes]), length)
    total = np.bincount(tile, minlength=len(blocks))
    column = np.arange(len(flat)) - np.repeat(np.cumsum(total) - total, total)
    listed = np.zeros((len(blocks), width), dtype=np.int64)
    is_cell = np.zeros((len(blocks), width), dtype=bool)
    listed[tile, column], is_cell[tile, column] = flat, True
    return listed, is_cell
