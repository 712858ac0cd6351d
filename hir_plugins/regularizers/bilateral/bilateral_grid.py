"""Bilateral means of any number of places in linear time: places that are near and alike are taken together.

A mean over all pairs costs n². Here the places q are gathered in cells: cubes of the surface, each divided again by
the guide (albedo, say). A place p hears the cells of all cubes nearer than the cutoff, and each speaks with the
first-order expansion of the kernel about its centroid x̄, so with weights `k(p, x̄)·(1 + (p − x̄)·(q − x̄))`: its number
of places, their mean value and the covariance of value and place are all that is needed. How many cells a place
hears depends on the widths of the kernel and on the colours around it, not on n; where every place has a cell of its
own, nothing is approximated but the cutoff. `bilateral_pairs.py` has the sum over all pairs and the error's bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from hir_core.errors import StageError

_PAIRS = 4_000_000
"""Pairs of place and cell evaluated at once: bounds memory at about 200 MB, also in the backward pass."""
_ROWS = 128
"""Places of one block that share a list of cells in one evaluation."""
_BLOCK = 2
"""Cubes along the side of a block of listening places."""
_QUIET = -40.0
"""Logarithm of weights of no account. Smaller ones would be denormal numbers, which are slower by tens of times."""
_SPAN = 1 << 14
"""Steps of the guide's cells along one channel that a key can hold."""


@dataclass(frozen=True, eq=False)
class Cubes:
    """Fixed places sorted into cubes of the surface, and which cubes the places of a block of 2³ cubes hear."""

    positions: Float[Tensor, "N 3"]
    """In σ, in the order given."""
    cube: Int[Tensor, " N"]
    """Of each place."""
    block: Int[Tensor, " N"]
    """Of each place."""
    order: Int[Tensor, " N"]
    """Places by block."""
    first: Int[Tensor, " B+1"]
    """Where each block begins in `order`."""
    heard: Int[Tensor, " M"]
    """Cubes nearer than the cutoff, block after block."""
    heard_first: Int[Tensor, " B+1"]


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
    """Sorts places (in σ) into cubes of `edge`; a block hears all cubes whose bounds are within `cutoff` of its own."""
    from scipy.spatial import cKDTree

    points = positions.detach().cpu().double().numpy()
    if not np.isfinite(points).all():
        raise StageError("the mesh has vertices that are not finite, so nothing on it is near; repair it first")
    index = np.floor((points - points.min(axis=0, initial=0.0)) / edge)
    cube, _, _, cube_low, cube_high = _grouped(index, points)
    block, order, first, low, high = _grouped(index // _BLOCK, points)
    centres = [cKDTree((a + b) / 2) for a, b in ((low, high), (cube_low, cube_high))]
    reach = cutoff + 0.5 * np.sqrt(3) * (_BLOCK + 1) * edge
    near = centres[0].sparse_distance_matrix(centres[1], reach * (1 + 1e-9), output_type="ndarray")
    listener, speaker = near["i"].astype(np.int64), near["j"].astype(np.int64)
    gap = np.maximum(np.maximum(low[listener] - cube_high[speaker], cube_low[speaker] - high[listener]), 0)
    kept = (gap**2).sum(axis=1) <= cutoff**2
    listener, speaker = listener[kept], speaker[kept]
    sorted_ = np.lexsort((speaker, listener))
    heard_first = np.searchsorted(listener[sorted_], np.arange(len(low) + 1))
    parts: list[NDArray[np.int64]] = [cube, block, order, first, speaker[sorted_], heard_first]
    return Cubes(positions.detach(), *(torch.from_numpy(p).to(positions.device) for p in parts))


def _grouped(index: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[NDArray[Any], ...]:
    """Group of each point by its index, points by group, where each group begins, and its bounds."""
    groups, of_point = np.unique(index, axis=0, return_inverse=True)
    of_point = of_point.reshape(-1)
    order = np.argsort(of_point, kind="stable")
    first = np.searchsorted(of_point[order], np.arange(len(groups) + 1))
    low, high = (reduce.reduceat(points[order], first[:-1], axis=0) for reduce in (np.minimum, np.maximum))
    return of_point, order, first, low, high


def bilateral_deviation(
    cubes: Cubes, guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"], edge: float
) -> Float[Tensor, "N D"]:
    """`values − Σ_q k values_q / Σ_q k` at each place, guide in units of its σ, its cells of `edge`; differentiable.

    Equal values give exactly 0. The sums run over the cells that `cells_of` makes.
    """
    cells = cells_of(cubes, guide, values, edge)
    feature = torch.cat([cubes.positions.to(guide.dtype), guide], dim=1)
    slope, channels = cells.slope.flatten(1), values.shape[1]
    # value at q of the plane through a cell's mean: level + q·slope
    level = cells.value - (cells.feature[..., None] * cells.slope).sum(1)
    spoken = torch.cat([cells.feature, cells.count.log()[:, None], level, slope], dim=1)
    split = [feature.shape[1], 1, channels, slope.shape[1]]

    def part(rows: Tensor, real: Tensor, listed: Tensor, sounding: Tensor, *leaves: Tensor) -> Tensor:
        places, place_values, speech = leaves
        p, (q, weight, levels, slopes) = places[rows], speech[listed].split(split, dim=-1)
        origin, ground = p[:, :1].detach(), place_values[rows[:, :1]].detach()
        weight = weight.masked_fill(~sounding[..., None], _QUIET)
        exponent = _with_norm(p - origin, 0.0, first=True) @ _with_norm(q - origin, weight, first=False).mT
        kernel = exponent.clamp_min(_QUIET).exp()
        # equal values are equal to the ground: their differences vanish to the last bit
        heard = kernel @ torch.cat([torch.ones_like(weight), levels - ground, slopes], dim=-1)
        total, above, tilt = heard.split([1, channels, slopes.shape[-1]], dim=-1)
        mean = (above + (p[..., None] * tilt.unflatten(-1, (-1, channels))).sum(-2)) / total
        return (place_values[rows] - ground - mean)[real]

    deviations, places_done = [], []
    for tile in _tiles(cubes, cells):
        deviations.append(checkpoint(part, *tile, feature, values, spoken, use_reentrant=False))
        places_done.append(tile[0][tile[1]])
    if not deviations:
        return torch.zeros_like(values)
    back = torch.argsort(torch.cat(places_done))
    return torch.cat(deviations)[back]


def _with_norm(x: Float[Tensor, "B K F"], more: Tensor | float, *, first: bool) -> Float[Tensor, "B K F+2"]:
    """Columns whose products, of a first with a second, are `−½‖x − y‖² + more`."""
    norm = more - 0.5 * x.square().sum(-1, keepdim=True)
    ones = torch.ones_like(norm)
    return torch.cat([x, norm, ones] if first else [x, ones, norm], dim=-1)


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
    cubes_in_all = int(cubes.cube.max()) + 1 if count else 0
    first = torch.searchsorted(of_cell, torch.arange(cubes_in_all + 1, device=key.device))
    return Cells(key, number, centroid, middle, slope, first)


def _tiles(cubes: Cubes, cells: Cells) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Rows (T R) of places with which of them are real, and the cells (T W) that they hear with which of those sound.

    Tiles of like size go together, padded: with the first place as a row that is not real, with a silent cell.
    """
    device = cells.count.device
    order, first = cubes.order.cpu().numpy(), cubes.first.cpu().numpy()
    heard, heard_first = cubes.heard.cpu().numpy(), cubes.heard_first.cpu().numpy()
    cell_first = cells.first.cpu().numpy()
    size = np.diff(cell_first)
    before = np.concatenate([[0], np.cumsum(size[heard])])
    width = before[heard_first[1:]] - before[heard_first[:-1]]
    most = np.clip(_PAIRS // np.maximum(width, 1), 1, _ROWS)
    per_block = -(-np.diff(first) // most)
    block = np.repeat(np.arange(len(width)), per_block)
    begin = first[block] + most[block] * (
        np.arange(len(block)) - np.repeat(np.cumsum(per_block) - per_block, per_block)
    )
    rows = np.minimum(first[block + 1] - begin, most[block])
    wanted = 1 << np.ceil(np.log2(rows)).astype(np.int64)
    by_size = np.lexsort((width[block], wanted))
    start = 0
    while start < len(by_size):
        stop = _chunk_end(by_size, start, wanted, width[block])
        tile = by_size[start:stop]
        slot = np.arange(wanted[tile[-1]])
        real = slot < rows[tile, None]
        row = order[begin[tile, None] + np.where(real, slot, 0)]
        listed = _listed(block[tile], heard, heard_first, cell_first, size, int(width[block[tile]].max()))
        row_, real_, listed_, sounding = (torch.from_numpy(part).to(device) for part in (row, real, *listed))
        yield row_, real_, listed_, sounding
        start = stop


def _chunk_end(by_size: NDArray[np.int64], start: int, rows: NDArray[np.int64], width: NDArray[np.int64]) -> int:
    """How far tiles of one number of rows go until their pairs, or the features of their cells, fill an evaluation."""
    same = rows[by_size[start]]
    high = int(np.searchsorted(rows[by_size], same, side="right"))
    widths = width[by_size[start:high]]
    pairs = np.arange(1, len(widths) + 1) * widths * (same + 32)
    return start + max(1, int(np.searchsorted(pairs, _PAIRS, side="right")))


def _listed(
    blocks: NDArray[np.int64],
    heard: NDArray[np.int64],
    heard_first: NDArray[np.int64],
    cell_first: NDArray[np.int64],
    size: NDArray[np.int64],
    width: int,
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Cells (T W) that each of the blocks hears, filled up with cell 0, and which are not filling."""
    speakers = [heard[heard_first[b] : heard_first[b + 1]] for b in blocks]
    speaker = np.concatenate(speakers)
    length = size[speaker]
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    flat = np.repeat(cell_first[speaker], length) + offset
    tile = np.repeat(np.repeat(np.arange(len(blocks)), [len(s) for s in speakers]), length)
    total = np.bincount(tile, minlength=len(blocks))
    column = np.arange(len(flat)) - np.repeat(np.cumsum(total) - total, total)
    listed = np.zeros((len(blocks), width), dtype=np.int64)
    sounding = np.zeros((len(blocks), width), dtype=bool)
    listed[tile, column], sounding[tile, column] = flat, True
    return listed, sounding
