"""The bilinear lookup of images, in torch: the texels around a position, and their weights.

Positions are in texels, with 0 at the centre of the first texel, so u in 0…1 is at `u * width - 0.5`. Each axis has its
own border rule:

- `repeat`: the image is periodic.
- `clamp`: the position is clamped to the centres of the border texels.
- `extend`: the border texels go on outside. The values are those of `clamp`; the weights of both neighbours remain, and
  both are the border texel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

Border = Literal["repeat", "clamp", "extend"]


@dataclass(frozen=True, eq=False)
class AxisNeighbours:
    """The two texels around N positions along one axis."""

    low: Int[Tensor, " N"]
    high: Int[Tensor, " N"]
    fraction: Float[Tensor, " N"]
    """Weight of `high`; that of `low` is 1 minus it."""


def axis_neighbours(position: Float[Tensor, " N"], count: int | Int[Tensor, " N"], border: Border) -> AxisNeighbours:
    """The texels around positions along an axis of `count` texels (one number, or one for each position)."""
    count = torch.as_tensor(count, device=position.device)
    if border == "clamp":
        position = torch.minimum(position.clamp_min(0), (count - 1).to(position))
        floor = torch.minimum(position.floor(), (count - 2).clamp_min(0).to(position))
    else:
        floor = position.floor()
    fraction = position - floor
    low = floor.long()
    if border == "repeat":
        low = low % count
        return AxisNeighbours(low, (low + 1) % count, fraction)
    high = torch.minimum(low + 1, count - 1)
    if border == "extend":
        low, high = torch.minimum(low.clamp_min(0), count - 1), high.clamp_min(0)
    return AxisNeighbours(low, high, fraction)


def bilinear_weights(
    x: AxisNeighbours, y: AxisNeighbours, width: int | Int[Tensor, " N"]
) -> tuple[Int[Tensor, "N 4"], Float[Tensor, "N 4"]]:
    """Indices of the four texels in the flattened image of `width` columns, and their weights."""
    index = torch.stack(
        [y.low * width + x.low, y.low * width + x.high, y.high * width + x.low, y.high * width + x.high], dim=1
    )
    fx, fy = x.fraction, y.fraction
    weight = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], dim=1)
    return index, weight


def texture_texels(
    uv: Float[Tensor, "N 2"], height: int, width: int
) -> tuple[Int[Tensor, "N 4"], Float[Tensor, "N 4"]]:
    """Texels and weights of lookups in a texture; coordinates are clamped."""
    x = axis_neighbours(uv[:, 0].clamp(0, 1) * width - 0.5, width, "clamp")
    y = axis_neighbours(uv[:, 1].clamp(0, 1) * height - 0.5, height, "clamp")
    return bilinear_weights(x, y, width)


def bilinear_values(
    texels: Float[Tensor, "T C"], x: AxisNeighbours, y: AxisNeighbours, width: int
) -> Float[Tensor, "N C"]:
    """Values of a flattened image of `width` columns, by linear interpolation: exact for a constant image."""
    first, second = x.fraction[:, None], y.fraction[:, None]
    upper = torch.lerp(_row(texels, y.low, x.low, width), _row(texels, y.low, x.high, width), first)
    lower = torch.lerp(_row(texels, y.high, x.low, width), _row(texels, y.high, x.high, width), first)
    return torch.lerp(upper, lower, second)


def _row(texels: Tensor, row: Tensor, column: Tensor, width: int) -> Tensor:
    return texels.index_select(0, row * width + column)
