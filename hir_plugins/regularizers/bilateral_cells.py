"""Bilateral means of any number of places in linear time: places that are near and alike are taken together.

A mean over all pairs costs n². Here the places q are gathered in cells: cubes of the surface, each divided again by
the guide (albedo, say). Every place p hears the cells whose cube is nearer than the cutoff. A cell speaks with the
first-order expansion of the kernel about its centroid x̄, so with weights `k(p, x̄)·(1 + (p − x̄)·(q − x̄))`: its number
of places, their mean value and the covariance of value and place are all that is needed. How many cells a place
hears depends on the widths of the kernel and on the colours around it, not on n; where every place has a cell of its
own, nothing is approximated but the cutoff. `bilateral_pairs.py` has the sum over all pairs and the error's bound.
"""
# ruff: noqa: TID253 - implementation module

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from hir_core.errors import StageError

_PAIRS = 4_000_000
"""Pairs of place and cell evaluated at once: bounds memory at about 200 MB, also in the backward pass."""
_ROWS = 64
"""Places of one cube that share a list of cells in one evaluation."""
_SPAN = 1 << 14
"""Steps of the guide's cells along one channel that a key can hold."""


@dataclass(frozen=True, eq=False)
class Cubes:
    """Fixed places sorted into cubes of the surface, and which cubes each of them hears."""

    positions: Float[Tensor, "N 3"]
    """In σ, in the order given."""
    cube: Int[Tensor, " N"]
    """Of each place."""
    order: Int[Tensor, " N"]
    """Places by cube."""
    first: Int[Tensor, " S+1"]
    """Where each cube begins in `order`."""
    heard: Int[Tensor, " M"]
    """Cubes nearer than the cutoff, cube after cube, itself among them."""
    heard_first: Int[Tensor, " S+1"]


@dataclass(frozen=True, eq=False)
class Cells:
    """Places that share a cube and a cell of the guide, cube after cube."""

    of_place: Int[Tensor, " N"]
    count: Float[Tensor, " C"]
    feature: Float[Tensor, "C F"]
    """Centroid of position and guide."""
    value: Float[Tensor, "C D"]
    """Mean."""
    slope: Float[Tensor, "C F D"]
    """Covariance of feature and value."""
    first: Int[Tensor, " S+1"]
    """Where each cube's cells begin."""


def cubes_of(positions: Float[Tensor, "N 3"], cutoff: float, edge: float) -> Cubes:
    """Sorts places (in σ) into cubes of `edge`; cubes with a pair of places nearer than `cutoff` hear each other."""
    from scipy.spatial import cKDTree

    points = positions.detach().cpu().double().numpy()
    if not np.isfinite(points).all():
        raise StageError("the mesh has vertices that are not finite, so nothing on it is near; repair it first")
    index = np.floor((points - points.min(axis=0, initial=0.0)) / edge)
    corners, cube = np.unique(index, axis=0, return_inverse=True)
    cube = cube.reshape(-1)
    order = np.argsort(cube, kind="stable")
    first = np.searchsorted(cube[order], np.arange(len(corners) + 1))
    low, high = (reduce.reduceat(points[order], first[:-1], axis=0) for reduce in (np.minimum, np.maximum))
    near = cKDTree(corners).query_pairs(cutoff / edge + np.sqrt(3) + 1e-6, output_type="ndarray").astype(np.int64)
    gap = np.maximum(np.maximum(low[near[:, 0]] - high[near[:, 1]], low[near[:, 1]] - high[near[:, 0]]), 0)
    near = near[(gap**2).sum(axis=1) <= cutoff**2]
    itself = np.arange(len(corners))
    listeners = np.concatenate([itself, near[:, 0], near[:, 1]])
    spoken = np.concatenate([itself, near[:, 1], near[:, 0]])
    by_listener = np.lexsort((spoken, listeners))
    heard_first = np.searchsorted(listeners[by_listener], np.arange(len(corners) + 1))
    parts: list[NDArray[np.int64]] = [cube, order, first, spoken[by_listener], heard_first]
    return Cubes(positions.detach(), *(torch.from_numpy(p).to(positions.device) for p in parts))


def bilateral_deviation(
    cubes: Cubes, guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"], edge: float
) -> Float[Tensor, "N D"]:
    """`values − Σ_q k values_q / Σ_q k` at each place, guide in units of its σ, its cells of `edge`; differentiable.

    Equal values give exactly 0. The sums run over the cells that `cells_of` makes.
    """
    cells = cells_of(cubes, guide, values, edge)
    feature = torch.cat([cubes.positions.to(guide.dtype), guide], dim=1)

    def part(rows: Tensor, real: Tensor, listed: Tensor, weight: Tensor, *leaves: Tensor) -> Tensor:
        places, place_values, centroids, means, slopes = leaves
        origin, ground = places[rows[:, :1]].detach(), place_values[rows[:, :1]].detach()
        p, q, slope = places[rows] - origin, centroids[listed] - origin, slopes[listed]
        apart = p.square().sum(-1)[:, :, None] + q.square().sum(-1)[:, None] - 2 * p @ q.mT
        kernel = weight[:, None] * torch.exp(-0.5 * apart.clamp_min(0))
        # equal values are equal to the ground: their differences vanish to the last bit
        level = means[listed] - ground - (q[..., None] * slope).sum(-2)
        tilted = (kernel @ slope.flatten(2)).unflatten(-1, slope.shape[2:])
        found = (kernel @ level + (p[..., None] * tilted).sum(-2)) / kernel.sum(-1, keepdim=True)
        return (place_values[rows] - ground - found)[real]

    deviations, places_done = [], []
    for rows, real, listed, weight in _tiles(cubes, cells):
        leaves = (feature, values, cells.feature, cells.value, cells.slope)
        deviations.append(checkpoint(part, rows, real, listed, weight.to(guide.dtype), *leaves, use_reentrant=False))
        places_done.append(rows[real])
    if not deviations:
        return torch.zeros_like(values)
    back = torch.argsort(torch.cat(places_done))
    return torch.cat(deviations)[back]


def cells_of(cubes: Cubes, guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"], edge: float) -> Cells:
    """Divides each cube by the guide in steps of `edge`; centroids and means are differentiable, membership is not."""
    with torch.no_grad():
        # what is not finite stays so in the sums, but may not choose a cell
        step = torch.floor(torch.nan_to_num(guide.detach().double(), 0.0, 0.0, 0.0) / edge)
        step -= step.amin(0) if len(step) else 0
        if bool((step >= _SPAN).any()):
            raise StageError(
                "a guide of the bilateral term spans more than 16000 of its widths; give it a larger sigma"
            )
        key = cubes.cube
        for channel in step.long().unbind(1):
            _, key = torch.unique(key * _SPAN + channel, return_inverse=True)
        count = int(key.max()) + 1 if len(key) else 0
        member = torch.empty(count, dtype=torch.long, device=key.device)
        member[key] = torch.arange(len(key), device=key.device)
        of_cell = cubes.cube[member]
    number = guide.new_zeros(count).index_add(0, key, torch.ones_like(guide[:, 0]))

    def mean(of: Tensor) -> Tensor:
        # about a member: a mean of equal numbers is that number
        about = of[member].detach()
        return about + of.new_zeros(count, of.shape[1]).index_add(0, key, of - about[key]) / number[:, None].to(of)

    feature = torch.cat([cubes.positions.to(guide.dtype), guide], dim=1)
    centroid, middle = mean(feature), mean(values)
    spread = (feature - centroid[key])[:, :, None] * (values - middle[key])[:, None]
    slope = mean(spread.flatten(1)).unflatten(1, spread.shape[1:])
    first = torch.searchsorted(of_cell, torch.arange(len(cubes.first), device=key.device))
    return Cells(key, number, centroid, middle, slope, first)


def _tiles(cubes: Cubes, cells: Cells) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Rows (B R) of places with which of them are real, and the cells (B W) that they hear with their counts.

    Tiles of like size go together, padded: with the first place as a row that is not real, with cells of count 0.
    """
    device = cells.count.device
    order, first = cubes.order.cpu().numpy(), cubes.first.cpu().numpy()
    heard, heard_first = cubes.heard.cpu().numpy(), cubes.heard_first.cpu().numpy()
    cell_first = cells.first.cpu().numpy()
    size = np.diff(cell_first)
    before = np.concatenate([[0], np.cumsum(size[heard])])
    width = before[heard_first[1:]] - before[heard_first[:-1]]
    most = np.clip(_PAIRS // np.maximum(width, 1), 1, _ROWS)
    per_cube = -(-np.diff(first) // most)
    cube = np.repeat(np.arange(len(width)), per_cube)
    begin = first[cube] + most[cube] * (np.arange(len(cube)) - np.repeat(np.cumsum(per_cube) - per_cube, per_cube))
    rows = np.minimum(first[cube + 1] - begin, most[cube])
    wanted = 1 << np.ceil(np.log2(rows)).astype(np.int64)
    by_size = np.lexsort((width[cube], wanted))
    start = 0
    while start < len(by_size):
        stop = _chunk_end(by_size, start, wanted, width[cube])
        tile = by_size[start:stop]
        slot = np.arange(wanted[tile[-1]])
        real = slot < rows[tile, None]
        row = order[begin[tile, None] + np.where(real, slot, 0)]
        listed, sounding = _listed(cube[tile], heard, heard_first, cell_first, size, int(width[cube[tile]].max()))
        index = torch.from_numpy(listed).to(device)
        weight = cells.count[index] * torch.from_numpy(sounding).to(device)
        yield torch.from_numpy(row).to(device), torch.from_numpy(real).to(device), index, weight
        start = stop


def _chunk_end(by_size: NDArray[np.int64], start: int, rows: NDArray[np.int64], width: NDArray[np.int64]) -> int:
    """How far tiles of one number of rows go until their pairs, or the features of their cells, fill an evaluation."""
    same = rows[by_size[start]]
    high = int(np.searchsorted(rows[by_size], same, side="right"))
    widths = width[by_size[start:high]]
    pairs = np.arange(1, len(widths) + 1) * widths * (same + 8)
    return start + max(1, int(np.searchsorted(pairs, _PAIRS, side="right")))


def _listed(
    cubes: NDArray[np.int64], heard: NDArray[np.int64], heard_first: NDArray[np.int64],
    cell_first: NDArray[np.int64], size: NDArray[np.int64], width: int,
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:  # fmt: skip
    """Cells (B W) that each of the cubes hears, filled up with cell 0, and which are not filling."""
    speakers = [heard[heard_first[c] : heard_first[c + 1]] for c in cubes]
    speaker = np.concatenate(speakers)
    length = size[speaker]
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    flat = np.repeat(cell_first[speaker], length) + offset
    tile = np.repeat(np.repeat(np.arange(len(cubes)), [len(s) for s in speakers]), length)
    total = np.bincount(tile, minlength=len(cubes))
    column = np.arange(len(flat)) - np.repeat(np.cumsum(total) - total, total)
    listed = np.zeros((len(cubes), width), dtype=np.int64)
    sounding = np.zeros((len(cubes), width), dtype=bool)
    listed[tile, column], sounding[tile, column] = flat, True
    return listed, sounding
