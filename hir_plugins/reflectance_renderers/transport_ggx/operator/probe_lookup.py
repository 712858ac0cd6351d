"""The radiance in a point's specular lobe, looked up in the radiance probe of its cache cell (Dr.Jit).

The lobe is one lookup in its mean direction, at the width of the symmetric lobe with the same mean (`lobe_moments.py`),
bilinear in the probe and linear between its levels. Reading the eight texels is most of the cost. So they form a
`Patch`, which also gives, by extrapolation, the radiance in lobes of nearby normals and levels. That is accurate enough
for derivatives.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from hir_exporters.conventions import ALPHA_MIN

from hir_plugins.reflectance_renderers.drjit_arrays import floats
from hir_plugins.reflectance_renderers.drjit_bilinear import bilinear, clamped, repeated
from hir_plugins.reflectance_renderers.drjit_latlong import latlong_coordinates
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.lobe_moments import (
    COSINES,
    LENGTHS,
    WIDTHS,
    moment_table,
    width_table,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import MIN_EYE_COSINE
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    ALPHA_LEVELS,
    MIN_LEVEL_ALPHA,
    PROBE_COLUMNS,
    PROBE_ROWS,
    RadianceProbes,
)

TEXELS_PER_PROBE = ALPHA_LEVELS * PROBE_ROWS * PROBE_COLUMNS
"""Texels of one cell's probe, all levels together."""
LEVELS_PER_E = float((ALPHA_LEVELS - 1) / -np.log(MIN_LEVEL_ALPHA))
"""Levels by which the width grows e-fold."""
MAX_PATCH_COLUMNS = 1.0
"""Extrapolation in columns is limited to this: near the poles a small rotation passes many columns."""


class ProbeTable:
    """The probes as a Dr.Jit array."""

    def __init__(self, probes: RadianceProbes) -> None:
        self.values = mi.Float16(probes.radiance.reshape(-1).cpu().numpy())


class Lobe(NamedTuple):
    """The position of a lobe in a probe, in texels from the centre of the first one, and its directional albedo."""

    column: DrJitArray
    row: DrJitArray
    level: DrJitArray
    """Of its width; 0 is the narrowest."""
    scale: DrJitArray
    """A of the directional albedo ρs·A + B."""
    bias: DrJitArray
    """B of it."""


class Patch(NamedTuple):
    """The eight texels around a lobe."""

    lobe: Lobe
    left: DrJitArray
    top: DrJitArray
    below: DrJitArray
    """`left`, `top`, `below`: column, row and level of the first texel, whole numbers."""
    images: DrJitArray
    """For each of two levels: the first texel, its differences along columns and rows, and the mixed difference."""


def lobe_of(normal: DrJitArray, eye: DrJitArray, level: DrJitArray, reflectance: DrJitArray, coupled: float) -> Lobe:
    """The lobe of a `level` of α (`radiance_probes.level_of`) and a mean ρs.

    `coupled` is 0 for the paper's model, where ρs is no F0 but scales the whole lobe, and 1 for `dielectric`.
    """
    alpha = MIN_LEVEL_ALPHA * dr.exp(dr.clip(level, 0, ALPHA_LEVELS - 1) / LEVELS_PER_E)
    cosine = dr.maximum(dr.dot(normal, eye), MIN_EYE_COSINE)
    scale, bias = albedo_terms(cosine, alpha)
    along, above = _mean_direction(cosine, alpha, (reflectance if coupled else 1) * scale, bias)
    u, v = latlong_coordinates(dr.normalize((along * cosine + above) * normal - along * eye))
    length = dr.sqrt(along * along * dr.maximum(1 - cosine * cosine, 0) + above * above)
    if coupled == 0:
        scale, bias = scale + bias, mi.Float(0)
    column, row = u * PROBE_COLUMNS - 0.5, dr.clip(v * PROBE_ROWS - 0.5, 0, PROBE_ROWS - 1.001)
    return Lobe(column, row, dr.clip(_level(length), 0, ALPHA_LEVELS - 1.001), scale, bias)


def _mean_direction(
    cosine: DrJitArray, alpha: DrJitArray, plain: DrJitArray, schlick: DrJitArray
) -> tuple[DrJitArray, DrJitArray]:
    """x and z (`lobe_moments.moment_table`) of a lobe whose part without Schlick's term and the other have albedos."""
    x = dr.sqrt(dr.clip(cosine, 0, 1)) * (COSINES - 1)
    y = (dr.sqrt(alpha) - ALPHA_MIN**0.5) * ((WIDTHS - 1) / (1 - ALPHA_MIN**0.5))
    table = _tables(mi.variant())[0]
    means = bilinear(
        lambda row, column: dr.gather(mi.Vector4f, table, row * WIDTHS + column),
        clamped(y, WIDTHS),
        clamped(x, COSINES),
    )
    share = schlick / dr.maximum(plain + schlick, 1e-6)
    return dr.lerp(means.x, means.z, share), dr.lerp(means.y, means.w, share)


def _level(length: DrJitArray) -> DrJitArray:
    """Level of the width of the symmetric lobe whose mean has this length."""
    place = clamped(dr.sqrt(dr.clip(1 - length, 0, 1)) * (LENGTHS - 1), LENGTHS)
    table = _tables(mi.variant())[1]
    width = dr.lerp(dr.gather(mi.Float, table, place.low), dr.gather(mi.Float, table, place.high), place.fraction)
    return (width - float(np.log(MIN_LEVEL_ALPHA))) * LEVELS_PER_E


@lru_cache(maxsize=4)
def _tables(variant: str) -> tuple[DrJitArray, DrJitArray]:
    return floats(moment_table(), mi), floats(width_table(), mi)


def patch_around(probes: DrJitArray, first: DrJitArray, lobe: Lobe) -> Patch:
    """Reads the texels around a lobe from `ProbeTable.values`; the cell's probe begins at texel `first`."""
    left, top, below = dr.floor(lobe.column), dr.floor(lobe.row), dr.floor(lobe.level)
    upper, nearer = mi.Int32(top), mi.Int32(below)
    columns = repeated(lobe.column, PROBE_COLUMNS)
    column, right = columns.low, columns.high

    def at(level: DrJitArray, row: DrJitArray, column: DrJitArray) -> DrJitArray:
        index = first + mi.UInt32((level * PROBE_ROWS + row) * PROBE_COLUMNS + column)
        return mi.Vector3f(dr.gather(mi.Array3f16, probes, index))  # type: ignore[arg-type]

    def image(level: DrJitArray) -> tuple[DrJitArray, DrJitArray, DrJitArray, DrJitArray]:
        here, across = at(level, upper, column), at(level, upper, right)
        down, both = at(level, upper + 1, column), at(level, upper + 1, right)
        return here, across - here, down - here, both - across - down + here

    return Patch(lobe, left, top, below, (image(nearer), image(nearer + 1)))


def patch_radiance(patch: Patch, lobe: Lobe) -> DrJitArray:
    """Mean radiance in a lobe on a patch or near it; not negative."""
    away = lobe.column - patch.lobe.column
    away -= PROBE_COLUMNS * dr.round(away / PROBE_COLUMNS)
    across = patch.lobe.column - patch.left + dr.clip(away, -MAX_PATCH_COLUMNS, MAX_PATCH_COLUMNS)
    down = lobe.row - patch.top
    near, far = (here + across * x + down * (y + across * xy) for here, x, y, xy in patch.images)
    return dr.maximum(dr.lerp(near, far, lobe.level - patch.below), 0)
