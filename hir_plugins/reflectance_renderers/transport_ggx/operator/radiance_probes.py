"""What a lobe of a given width receives, for every cell and direction: the light with what hides it, filtered once.

A probe is the radiance that arrives at a cell, from the sky or from the surface, as a small lat-long image for each of
`LEVELS` widths: a sum of split lobe and light (Karis 2013), but of the cell's own light. A lobe is then one lookup.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import row_solid_angles, texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

NARROWEST = 0.08
"""α of the first level: about a texel of a probe."""
LEVELS = 7
"""Widths from `NARROWEST` to 1, at equal ratios."""
ROWS, COLUMNS = 24, 48
CELLS_AT_ONCE = 500


@dataclass(frozen=True, eq=False)
class Probes:
    """Filtered radiance of every cell."""

    radiance: Float[Tensor, "C L D 3"]
    """float16; D directions, row by row (docs/conventions.md)."""


def level_of(alpha: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Where a width lies among the levels, 0…`LEVELS` − 1."""
    place = (alpha.clamp(NARROWEST, 1) / NARROWEST).log() * ((LEVELS - 1) / -math.log(NARROWEST))
    return place.clamp(0, LEVELS - 1)


def alpha_of(level: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The inverse of `level_of`."""
    return NARROWEST * torch.exp(level.clamp(0, LEVELS - 1) * (-math.log(NARROWEST) / (LEVELS - 1)))


def make_probes(transport: Transport, sky: Float[Tensor, "T 3"], leaving: Float[Tensor, "C 3"]) -> Probes:
    """Filters the light `sky`, in texels of the level that irradiance is stored for, and the radiance that leaves the
    cells; of those that a cell sees the mean stands for all.
    """
    rows = next(h for h, w in transport.pyramid.shapes if h * w == len(sky))
    lobes = _lobes(rows).to(sky).T
    open_sky = transport.diffuse.sky.matrix > 0
    share = transport.diffuse.bounce @ leaving.new_ones(len(leaving), 1)
    around = (transport.diffuse.bounce @ leaving) / share.clamp_min(1e-6)
    around = torch.where(share > 1e-3, around, leaving.mean(dim=0))
    table = torch.empty(len(leaving), lobes.shape[1], 3, dtype=torch.float16, device=sky.device)
    for start in range(0, len(leaving), CELLS_AT_ONCE):
        part = slice(start, start + CELLS_AT_ONCE)
        seen = open_sky[part].to(sky)
        hidden = 1 - seen @ lobes
        for channel in range(3):
            found = (seen * sky[:, channel]) @ lobes + hidden * around[part, channel : channel + 1]
            table[part, :, channel] = found.clamp(0, torch.finfo(torch.float16).max).half()
    return Probes(table.reshape(len(leaving), LEVELS, ROWS * COLUMNS, 3))


def _lobes(rows: int) -> Float[Tensor, "LD T"]:
    """GGX lobes seen along their normal, each of sum 1, over the texels of a light of `rows` rows."""
    toward = texel_directions(rows, 2 * rows)
    solid = row_solid_angles(rows, torch.float32, toward.device).repeat_interleave(2 * rows)
    cosine = texel_directions(ROWS, COLUMNS) @ toward.T
    # the half vector's cosine, squared; a lobe about the mirrored direction is as wide as one about the normal
    half = ((1 + cosine) / 2).clamp(0, 1)
    square = alpha_of(torch.arange(LEVELS, dtype=torch.float32)).square()[:, None, None]
    lobes = square / (half * (square - 1) + 1).square() * cosine.clamp_min(0) * solid
    return (lobes / lobes.sum(dim=2, keepdim=True).clamp_min(1e-30)).reshape(-1, len(toward))
