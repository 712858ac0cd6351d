"""Bilateral means over all pairs of samples: the definition, quadratic in time; and the error bound of the grid."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from hir_plugins.regularizers.bilateral.bilateral_grid import Cubes, cells_of

_PAIRS = 2_000_000
"""Pairs of samples evaluated at once: bounds memory at about 200 MB, also in the backward pass."""


def deviation_of_pairs(
    positions: Float[Tensor, "N 3"], guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"]
) -> Float[Tensor, "N D"]:
    """`values − Σ_q k values_q / Σ_q k` over all q, `k = exp(−½‖p − q‖²)` with positions and guide in their σ."""

    def part(rows: Tensor, g: Tensor, v: Tensor) -> Tensor:
        p = positions.to(g.dtype)
        distance2 = (p[rows, None] - p).square().sum(-1) + (g[rows, None] - g).square().sum(-1)
        kernel = torch.exp(-0.5 * distance2)
        # differences first, so that equal values give exactly 0; k_pp = 1, so the sum is never 0
        return (kernel[..., None] * (v[rows, None] - v)).sum(1) / kernel.sum(1, keepdim=True)

    parts = [checkpoint(part, rows, guide, values, use_reentrant=False) for rows in _blocks(len(positions))]
    return torch.cat(parts) if parts else torch.zeros_like(values)


def absolute_deviation_of_pairs(
    positions: Float[Tensor, "N 3"], guide: Float[Tensor, "N G"], values: Float[Tensor, "N D"]
) -> tuple[Float[Tensor, ""], Float[Tensor, "N D"]]:
    """The sum of the absolute values of all deviations, and these, without gradients."""
    deviations = deviation_of_pairs(positions, guide, values)
    return deviations.abs().sum(), deviations.detach()


def weight_error(cubes: Cubes, guide: Float[Tensor, "N G"], edge: float) -> Float[Tensor, " N"]:
    """`ε_p = Σ_q |k − k̃| / Σ_q k` of the weights k̃ that `absolute_deviation` gives the samples; quadratic in time.

    Its means m̃ lie within `ε_p · max_q |v_q − m̃_p|` of those over all pairs, whatever the values v are: the true mean m
    has `m − m̃ = Σ (k − k̃)(v − m̃) / Σ k`, for Σ k̃ (v − m̃) = 0 by the definition of m̃.
    """
    guide = guide.detach().double()
    cells = cells_of(cubes, guide, guide, edge)
    feature = torch.cat([cubes.positions.double(), guide], dim=1)
    centroid = cells.feature[cells.of_sample]
    near = _near_cubes(cubes)
    errors = []
    for rows in _blocks(len(feature)):
        kernel = torch.exp(-0.5 * (feature[rows, None] - feature).square().sum(-1))
        away = feature[rows, None] - centroid
        approximated = torch.exp(-0.5 * away.square().sum(-1)) * (1 + (away * (feature - centroid)).sum(-1))
        approximated = approximated * near[cubes.block[rows]][:, cubes.cube]
        errors.append((kernel - approximated).abs().sum(1) / kernel.sum(1))
    return torch.cat(errors) if errors else feature.new_zeros(0)


def _near_cubes(cubes: Cubes) -> Bool[Tensor, "B S"]:
    """Whether the cube of the column is within the cutoff of the block of the row."""
    blocks = len(cubes.first) - 1
    near = torch.zeros(blocks, int(cubes.cube.max()) + 1, dtype=torch.bool, device=cubes.near.device)
    block = torch.repeat_interleave(torch.arange(blocks, device=near.device), cubes.near_first.diff())
    near[block, cubes.near] = True
    return near


def _blocks(count: int) -> Iterator[Tensor]:
    step = max(_PAIRS // max(count, 1), 1)
    for start in range(0, count, step):
        yield torch.arange(start, min(start + step, count))
