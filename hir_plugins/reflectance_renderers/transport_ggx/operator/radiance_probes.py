"""Prefiltered incident radiance of every cache cell, occlusion included: the specular lobe becomes one lookup.

A radiance probe is the radiance that arrives at a cell, from the light or from the surface, as a small lat-long image
for each of `ALPHA_LEVELS` widths. It is the prefiltered light of the split-sum approximation (Karis 2013), for each
cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import row_solid_angles, texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

MIN_LEVEL_ALPHA = 0.08
"""α of the first level: a lobe about as wide as a texel of a probe."""
ALPHA_LEVELS = 7
"""Number of widths from `MIN_LEVEL_ALPHA` to 1, at equal ratios."""
PROBE_ROWS, PROBE_COLUMNS = 24, 48
PROBES_PER_CHUNK = 500


@dataclass(frozen=True, eq=False)
class RadianceProbes:
    """Prefiltered radiance of every cache cell."""

    radiance: Float[Tensor, "C L D 3"]
    """float16; L levels of α, D directions, row by row (docs/conventions.md)."""


def level_of(alpha: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The level of a width, as a real number in 0…`ALPHA_LEVELS` − 1."""
    level = (alpha.clamp(MIN_LEVEL_ALPHA, 1) / MIN_LEVEL_ALPHA).log() * (
        (ALPHA_LEVELS - 1) / -math.log(MIN_LEVEL_ALPHA)
    )
    return level.clamp(0, ALPHA_LEVELS - 1)


def alpha_of(level: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The inverse of `level_of`."""
    return MIN_LEVEL_ALPHA * torch.exp(
        level.clamp(0, ALPHA_LEVELS - 1) * (-math.log(MIN_LEVEL_ALPHA) / (ALPHA_LEVELS - 1))
    )


def build_probes(transport: Transport, sky: Float[Tensor, "T 3"], leaving: Float[Tensor, "C 3"]) -> RadianceProbes:
    """Filters the light and the radiance that leaves the cache cells.

    `sky` has the texels of the pyramid level of the irradiance matrices. All cells that a cell sees are replaced by
    their mean.
    """
    rows = next(h for h, w in transport.pyramid.shapes if h * w == len(sky))
    lobes = _lobes(rows).to(sky).T
    open_sky = transport.diffuse.sky.matrix > 0
    share = transport.diffuse.bounce @ leaving.new_ones(len(leaving), 1)
    around = (transport.diffuse.bounce @ leaving) / share.clamp_min(1e-6)
    around = torch.where(share > 1e-3, around, leaving.mean(dim=0))
    table = torch.empty(len(leaving), lobes.shape[1], 3, dtype=torch.float16, device=sky.device)
    for start in range(0, len(leaving), PROBES_PER_CHUNK):
        part = slice(start, start + PROBES_PER_CHUNK)
        seen = open_sky[part].to(sky)
        occluded = 1 - seen @ lobes
        for channel in range(3):
            filtered = (seen * sky[:, channel]) @ lobes + occluded * around[part, channel : channel + 1]
            table[part, :, channel] = filtered.clamp(0, torch.finfo(torch.float16).max).half()
    return RadianceProbes(table.reshape(len(leaving), ALPHA_LEVELS, PROBE_ROWS * PROBE_COLUMNS, 3))


def _lobes(rows: int) -> Float[Tensor, "LD T"]:
    """GGX lobes for a view along the normal, each of sum 1, over the texels of a light of `rows` rows."""
    toward = texel_directions(rows, 2 * rows)
    solid = row_solid_angles(rows, torch.float32, toward.device).repeat_interleave(2 * rows)
    cosine = texel_directions(PROBE_ROWS, PROBE_COLUMNS) @ toward.T
    # squared cosine of the half vector
    half = ((1 + cosine) / 2).clamp(0, 1)
    square = alpha_of(torch.arange(ALPHA_LEVELS, dtype=torch.float32)).square()[:, None, None]
    above = cosine.clamp_min(0)
    shown = 2 * above / (above + (square + (1 - square) * above.square()).sqrt())
    lobes = square / (half * (square - 1) + 1).square() * shown * solid
    return (lobes / lobes.sum(dim=2, keepdim=True).clamp_min(1e-30)).reshape(-1, len(toward))
