"""Deviations from bilateral means over the cells of a grid, and the gradient of their absolute sum, tile by tile.

A tile is a few hundred samples and the cells near them. Each kernel of a tile is evaluated once, for value and
gradient. Matrices have their few channels first: a thin left factor makes the products several times as fast.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.regularizers.bilateral.bilateral_grid import Cubes, GridCells, Tile, cells_of, tiles_of

_LEAST_LOG_WEIGHT: Final = -40.0
"""Logarithm of a negligible weight. Smaller weights would be denormal numbers, which are tens of times slower."""


def absolute_deviation(
    cubes: Cubes, guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"], edge: float
) -> tuple[Float[Tensor, ""], Float[Tensor, "N D"]]:
    """`Σ_p ‖values_p − Σ_q k values_q / Σ_q k‖₁`, differentiable once, and the deviations, without gradients.

    The guide is in units of its σ, its cells of `edge`. Equal values give exactly 0. The sums run over the cells that
    `cells_of` makes.
    """
    cells = cells_of(cubes, guide, values, edge)
    level, slope = _planes(cells)
    centroid = cells.feature[:, cubes.positions.shape[1] :]  # its position does not depend on guide or values
    total, deviations = _AbsoluteDeviation.apply(cubes, cells, guide, values, centroid, level, slope)
    return total, deviations


def _planes(cells: GridCells) -> tuple[Float[Tensor, "C D"], Float[Tensor, "C FD"]]:
    """Level and slope of the plane through each cell's mean: the value at a feature x is level + x·slope."""
    level = cells.value - (cells.feature[..., None] * cells.slope).sum(1)
    return level, cells.slope.flatten(1)


@dataclass(frozen=True, eq=False)
class _TileSums:
    """The kernels of one tile and what follows from them; R samples, W cells, F features, D values."""

    samples: Float[Tensor, "T F R"]
    """Features of the samples, relative to the first of them."""
    cells: Float[Tensor, "T F W"]
    """Features of the cells, relative to the same."""
    kernel: Float[Tensor, "T R W"]
    table: Float[Tensor, "T 1+D+FD W"]
    """1, level and slope of the cells."""
    sums: Float[Tensor, "T 1+D+FD R"]
    mean: Float[Tensor, "T D R"]
    """Relative to the first sample's value."""
    deviation: Float[Tensor, "T D R"]


@dataclass(frozen=True, eq=False)
class _Sums:
    """Samples and cells of a grid."""

    features: Float[Tensor, "N F"]
    values: Float[Tensor, "N D"]
    cells: Float[Tensor, "C F+1+1+D+FD"]
    """Feature, logarithm of the number of samples, 1, level and slope."""

    @classmethod
    def of(cls, cubes: Cubes, cells: GridCells, guide: Tensor, values: Tensor, level: Tensor, slope: Tensor) -> _Sums:
        """For values and guide without gradients."""
        features = torch.cat([cubes.positions.to(guide.dtype), guide], dim=1)
        log_count = cells.count.log()[:, None]
        table = torch.cat([cells.feature, log_count, torch.ones_like(log_count), level, slope], dim=1)
        return cls(features, values, table)

    def at(self, tile: Tile) -> _TileSums:
        """The sums of the samples of a tile."""
        channels, width = self.values.shape[1], self.features.shape[1]
        features = self.features[tile.samples].mT
        listed = self.cells[tile.cells].mT.contiguous()
        origin, base = features[..., :1], self.values[tile.samples[:, :1]].mT
        p, q = features - origin, listed[:, :width] - origin
        log_weight = listed[:, width : width + 1].masked_fill(~tile.is_cell[:, None], _LEAST_LOG_WEIGHT)
        table = listed[:, width + 1 :]
        # relative to a value of the tile: for equal values all differences are exactly 0
        table[:, 1 : 1 + channels] -= base
        # −½‖p − q‖² + log_weight as one product
        ones = torch.ones_like(log_weight)
        left = torch.cat([p, -0.5 * p.square().sum(1, keepdim=True), torch.ones_like(p[:, :1])], dim=1)
        right = torch.cat([q, ones, log_weight - 0.5 * q.square().sum(1, keepdim=True)], dim=1)
        kernel = (left.mT @ right).clamp_min_(_LEAST_LOG_WEIGHT).exp_()
        sums = table @ kernel.mT
        slopes = sums[:, 1 + channels :].unflatten(1, (width, channels))
        mean = (sums[:, 1 : 1 + channels] + (features[:, :, None] * slopes).sum(1)) / sums[:, :1]
        deviation = self.values[tile.samples].mT - base - mean
        return _TileSums(p, q, kernel, table, sums, mean, deviation)


class _AbsoluteDeviation(torch.autograd.Function):
    """Value and gradients in one pass: the gradient of an absolute sum needs nothing from the steps after it."""

    @staticmethod
    def forward(ctx, cubes, cells, guide, values, centroid, level, slope):  # type: ignore[no-untyped-def]
        sums = _Sums.of(cubes, cells, guide, values, level, slope)
        gradients = _Gradients.zeros(guide, values, centroid, level, slope) if any(ctx.needs_input_grad) else None
        deviations = torch.zeros_like(values)
        for tile in tiles_of(cubes, cells):
            found = sums.at(tile)
            deviations[tile.samples[tile.is_sample]] = found.deviation.mT[tile.is_sample]
            if gradients is not None:
                gradients.add(tile, found, sums.features)
        ctx.gradients = gradients
        ctx.mark_non_differentiable(deviations)
        return deviations.abs().sum(), deviations

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, outer, _):  # type: ignore[no-untyped-def]
        gradients, ctx.gradients = ctx.gradients, None
        return None, None, *(outer * part for part in gradients.parts())


@dataclass(frozen=True, eq=False)
class _Gradients:
    """Gradients of the absolute sum."""

    guide: Float[Tensor, "N G"]
    values: Float[Tensor, "N D"]
    cells: Float[Tensor, "C G+1+D+FD"]
    """By centroid of the guide, by number of samples (not used), level and slope."""

    @classmethod
    def zeros(cls, guide: Tensor, values: Tensor, *cells: Tensor) -> _Gradients:
        """Before the first tile; `cells` are centroid, level and slope."""
        columns = 1 + sum(part.shape[1] for part in cells)
        return cls(torch.zeros_like(guide), torch.zeros_like(values), guide.new_zeros(len(cells[0]), columns))

    def parts(self) -> Iterable[Tensor]:
        """By guide, values, centroid of the guide, level and slope."""
        guide, channels = self.guide.shape[1], self.values.shape[1]
        centroid, _, level, slope = self.cells.split(
            [guide, 1, channels, self.cells.shape[1] - guide - 1 - channels], 1
        )
        return self.guide, self.values, centroid, level, slope

    def add(self, tile: Tile, found: _TileSums, features: Float[Tensor, "N F"]) -> None:
        """The part of a tile."""
        guide, channels = self.guide.shape[1], self.values.shape[1]
        sign = torch.where(tile.is_sample[:, None], found.deviation.sign(), 0)
        of_mean = -sign / found.sums[:, :1]
        p, q = found.samples[:, -guide:], found.cells[:, -guide:]
        features_of_samples = features[tile.samples].mT
        by_slopes = (features_of_samples[:, :, None] * of_mean[:, None]).flatten(1, 2)
        by_sums = torch.cat([-(of_mean * found.mean).sum(1, keepdim=True), of_mean, by_slopes], dim=1)
        by_exponent = (by_sums.mT @ found.table).mul_(found.kernel)
        of_samples = torch.cat([q, torch.ones_like(q[:, :1])], dim=1) @ by_exponent.mT
        of_cells = torch.cat([p, torch.ones_like(p[:, :1])], dim=1) @ by_exponent
        slopes = found.sums[:, 1 + channels :].unflatten(1, (-1, channels))[:, -guide:]
        by_p = (slopes * of_mean[:, None]).sum(2) + of_samples[:, :guide] - of_samples[:, guide:] * p
        by_q = of_cells[:, :guide] - of_cells[:, guide:] * q
        by_cell = torch.cat([by_q, by_sums @ found.kernel], dim=1)
        rows = tile.samples.flatten()
        self.guide.index_add_(0, rows, by_p.mT.flatten(0, 1))
        self.values.index_add_(0, rows, sign.mT.flatten(0, 1))
        self.cells.index_add_(0, tile.cells.flatten(), by_cell.mT.flatten(0, 1))
