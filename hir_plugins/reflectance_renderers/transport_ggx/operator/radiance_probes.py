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
PROBES_PER_CHUNK = 100
"""Memory of their arrays is used again for the next ones; with 500 it is new each time, which takes twice as long."""


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
    rows, columns = next((h, w) for h, w in transport.pyramid.shapes if h * w == len(sky))
    lobes = _LobeSpectra.of(rows, columns, sky.device)
    open_sky = transport.diffuse.sky.matrix > 0
    share = transport.diffuse.bounce @ leaving.new_ones(len(leaving), 1)
    around = (transport.diffuse.bounce @ leaving) / share.clamp_min(1e-6)
    around = torch.where(share > 1e-3, around, leaving.mean(dim=0))
    light = torch.cat([sky.T, sky.new_ones(1, len(sky))])
    table = torch.empty(
        len(leaving), ALPHA_LEVELS, PROBE_ROWS, PROBE_COLUMNS, 3, dtype=torch.float16, device=sky.device
    )
    for start in range(0, len(leaving), PROBES_PER_CHUNK):
        part = slice(start, start + PROBES_PER_CHUNK)
        seen = open_sky[part].to(sky)[:, None] * light
        *filtered, unoccluded = lobes.filtered(seen.reshape(-1, 4, rows, columns)).unbind(1)
        for channel, image in enumerate(filtered):
            radiance = image + (1 - unoccluded) * around[part, channel].reshape(-1, 1, 1, 1)
            table[part, ..., channel] = radiance.clamp(0, torch.finfo(torch.float16).max).half()
    return RadianceProbes(table.reshape(len(leaving), ALPHA_LEVELS, PROBE_ROWS * PROBE_COLUMNS, 3))


@dataclass(frozen=True, eq=False)
class _LobeSpectra:
    """Lobes over the texels of a lat-long image, as Fourier series along its rows.

    A lobe of another direction on the same parallel is the same lobe, rotated. So the columns of a probe are a
    correlation along rows, which is a product of spectra. Of N columns that images and probes have in common the result
    has a period, so frequencies that differ by a multiple of N are added (aliasing). Rounding is relative to the
    brightest texel, at most about 2·10⁻⁸ of it; a direct sum would keep its accuracy in dark directions, too.
    """

    spectra: Float[Tensor, "G RS2 LDP2"]
    """G frequencies of the result; R rows and S frequencies of the image that are added; L levels, D rows of a probe,
    and P columns, after which columns repeat with another rotation. Each complex number is a 2 × 2 matrix, because a
    product of real matrices is twice as fast."""
    common: int
    """N."""

    @classmethod
    def of(cls, rows: int, columns: int, device: torch.device) -> _LobeSpectra:
        """For images of `rows` × `columns` texels."""
        common = math.gcd(columns, PROBE_COLUMNS)
        lobes = _lobes(rows, columns, PROBE_COLUMNS // common).to(device) * (common / columns)
        spectra = _by_frequency(lobes, common).conj().transpose(1, 2)
        matrices = torch.view_as_real(torch.stack([spectra, 1j * spectra], dim=2).contiguous())
        return cls(matrices.flatten(3, 4).flatten(1, 2), common)

    def filtered(self, images: Float[Tensor, "B C R W"]) -> Float[Tensor, "B C L D K"]:
        """The images, seen through each lobe."""
        batch, channels, _, _ = images.shape
        spectra = torch.view_as_real(_by_frequency(images.flatten(0, 1), self.common)).flatten(2)
        products = torch.view_as_complex((spectra @ self.spectra).unflatten(2, (-1, 2)))
        result = torch.fft.irfft(products, n=self.common, dim=0)
        result = result.reshape(self.common, batch, channels, ALPHA_LEVELS, PROBE_ROWS, -1)
        return result.permute(1, 2, 3, 4, 0, 5).flatten(4)


def _by_frequency(images: Float[Tensor, "B R W"], common: int) -> Float[Tensor, "G B RS"]:
    """Spectra of the rows of images: frequencies 0 to `common` / 2, and those that differ by a multiple of `common`."""
    batch, rows, columns = images.shape
    spectra = torch.fft.fft(images, dim=2).reshape(batch, rows, columns // common, common)
    return spectra[..., : common // 2 + 1].permute(3, 0, 1, 2).flatten(2)


def _lobes(rows: int, columns: int, probe_columns: int) -> Float[Tensor, "LDP R W"]:
    """GGX lobes for a view along the normal, each of sum 1, over the texels of a light, for the first columns of each
    row of a probe.
    """
    toward = texel_directions(rows, columns)
    solid = row_solid_angles(rows, torch.float32, toward.device).repeat_interleave(columns)
    along = texel_directions(PROBE_ROWS, PROBE_COLUMNS).reshape(PROBE_ROWS, PROBE_COLUMNS, 3)[:, :probe_columns]
    cosine = along.reshape(-1, 3) @ toward.T
    # squared cosine of the half vector
    half = ((1 + cosine) / 2).clamp(0, 1)
    square = alpha_of(torch.arange(ALPHA_LEVELS, dtype=torch.float32)).square()[:, None, None]
    above = cosine.clamp_min(0)
    shown = 2 * above / (above + (square + (1 - square) * above.square()).sqrt())
    lobes = square / (half * (square - 1) + 1).square() * shown * solid
    return (lobes / lobes.sum(dim=2, keepdim=True).clamp_min(1e-30)).reshape(-1, rows, columns)
