"""Diffuse albedo at the texture's own resolution: all photographs' pixels see the bilinear texture, and the closed form
solves it (`closed_form.py`); the solution at vertices holds what no pixel sees.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.closed_form_albedo import AlbedoEquations, solve_albedo
from hir_plugins.reflectance_renderers.transport_ggx.operator.linear_maps import LinearMap

FEWEST_PIXELS = 1.0
"""Pixels that must look at a texel before it counts as observed."""
LEAST_INFORMATION = 0.7
"""Weight of a texel's pixels, in units of the start's, from which it counts as observed."""


@dataclass(frozen=True, eq=False)
class TexelEquations:
    """One row per pixel: `gain · (texture at uv) + rest = color`."""

    index: Int[Tensor, "P 4"]
    weight: Float[Tensor, "P 4"]
    gain: Float[Tensor, "P 3"]
    color: Float[Tensor, "P 3"]
    """Of the photograph, at equal exposure."""
    rest: Float[Tensor, "P 3"]
    """What the pixel shows besides: its lobe."""
    importance: Float[Tensor, "P 3"]
    at_least: Bool[Tensor, "P 3"]
    """Where the photograph is clipped: the left side may be larger."""
    pixel: Int[Tensor, "P 3"]
    """View, x and y."""


def bilinear_texels(
    uv: Float[Tensor, "P 2"], height: int, width: int
) -> tuple[Int[Tensor, "P 4"], Float[Tensor, "P 4"]]:
    """Texels and weights of bilinear lookups; held at the border."""
    x = (uv[:, 0].clamp(0, 1) * width - 0.5).clamp(0, width - 1)
    y = (uv[:, 1].clamp(0, 1) * height - 0.5).clamp(0, height - 1)
    x0, y0 = x.floor().clamp_max(max(width - 2, 0)), y.floor().clamp_max(max(height - 2, 0))
    fx, fy = x - x0, y - y0
    x0, y0 = x0.long(), y0.long()
    x1, y1 = (x0 + 1).clamp_max(width - 1), (y0 + 1).clamp_max(height - 1)
    index = torch.stack([y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1], dim=1)
    weight = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], dim=1)
    return index, weight


def solve_texels(
    equations: list[TexelEquations],
    start: Float[Tensor, "H W 3"],
    huber: float,
    prior: float,
    smooth: float = 0.0,
) -> tuple[Float[Tensor, "H W 3"], Bool[Tensor, "H W"]]:
    """Albedo in 0…1 and the texels that some pixel sees with a weight.

    `prior` and `smooth` are the weights of the start and of differences between neighbouring texels, as fractions of
    the mean weight of a seen texel.
    """
    height, width, _ = start.shape
    lookup = LinearMap.from_rows(
        torch.cat([e.index for e in equations]), torch.cat([e.weight for e in equations]), height * width
    )
    rows = AlbedoEquations(
        lookup,
        torch.cat([e.gain for e in equations]),
        torch.cat([e.color - e.rest for e in equations]),
        torch.cat([e.importance for e in equations]),
        torch.cat([e.at_least for e in equations]),
    )

    def differences(x: Float[Tensor, "N 3"], weight: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
        return _differences(*(values.reshape(height, width, 3) for values in (x, weight))).reshape(-1, 3)

    texture, seen, told = solve_albedo([rows], start.reshape(-1, 3), huber, prior, differences, smooth)
    # a texel that photographs only touch, or see in the dark, holds what it started from: it was not observed
    observed = (seen > FEWEST_PIXELS) & (told > LEAST_INFORMATION)
    return texture.reshape(height, width, 3), observed.reshape(height, width)


def _differences(x: Float[Tensor, "H W C"], weight: Float[Tensor, "H W C"]) -> Float[Tensor, "H W C"]:
    """The gradient of ½ Σ w_ij (x_i − x_j)² over neighbours, w_ij the smaller of their weights."""
    total = torch.zeros_like(x)
    for dim in (0, 1):
        if (last := x.shape[dim] - 1) > 0:
            step = x.narrow(dim, 1, last) - x.narrow(dim, 0, last)
            step = step * torch.minimum(weight.narrow(dim, 1, last), weight.narrow(dim, 0, last))
            total.narrow(dim, 1, last).add_(step)
            total.narrow(dim, 0, last).sub_(step)
    return total
