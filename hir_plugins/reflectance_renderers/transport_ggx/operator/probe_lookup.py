"""What a point's lobe receives, looked up in the `probes` of its cell (Dr.Jit).

The lobe is one lookup, towards the direction it has most of its light from (Lagarde & de Rousiers 2014), bilinear in
the probe and linear between its levels. It reads eight texels, which is most of its cost; so they are a `Patch` that
also tells, extrapolated, what lobes of nearby normals and levels receive: good enough for derivatives.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from hir_plugins.reflectance_renderers.mitsuba_ggx.ggx_drjit import albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    COLUMNS,
    LEVELS,
    NARROWEST,
    ROWS,
    Probes,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_lobes import LEAST_COSINE

PROBE = LEVELS * ROWS * COLUMNS
"""Texels of one cell's probe."""
FARTHEST = 1.0
"""Columns, at most, from the lobe that a patch was read for: near the poles a small turn passes many."""


class ProbeTable:
    """Probes where Dr.Jit reads them."""

    def __init__(self, probes: Probes) -> None:
        self.values = mi.Float16(probes.radiance.reshape(-1).cpu().numpy())


class Lobe(NamedTuple):
    """Where a lobe looks, in texels from the centre of the first one, and its albedo."""

    column: Any
    row: Any
    level: Any
    """0 is the narrowest."""
    scale: Any
    """Of ρs."""
    bias: Any
    """What is added to it."""


class Patch(NamedTuple):
    """The eight texels around a lobe."""

    lobe: Lobe
    left: Any
    top: Any
    below: Any
    """Column, row and level of the first, whole numbers."""
    images: Any
    """Of each of two levels: the first texel, its differences across and down, and the mixed one."""


def lobe_of(normal: Any, eye: Any, level: Any, coupled: float) -> Lobe:
    """The lobe of a `level` of α (`probes.level_of`); in the paper's model, which is not `coupled`, ρs is no F0: it
    scales all of the lobe.
    """
    alpha = NARROWEST * dr.exp(dr.clip(level, 0, LEVELS - 1) * float(-np.log(NARROWEST) / (LEVELS - 1)))
    cosine = dr.maximum(dr.dot(normal, eye), LEAST_COSINE)
    mirrored = dr.normalize(2 * cosine * normal - eye)
    smooth = 1 - alpha
    mostly = dr.normalize(dr.lerp(normal, mirrored, smooth * (dr.sqrt(dr.maximum(smooth, 0)) + alpha)))
    u = 0.5 - dr.atan2(mostly.x, mostly.z) / (2 * dr.pi)
    v = dr.atan2(dr.hypot(mostly.x, mostly.z), mostly.y) / dr.pi
    scale, bias = albedo_terms(cosine, alpha)
    if coupled == 0:
        scale, bias = scale + bias, mi.Float(0)
    column, row = u * COLUMNS - 0.5, dr.clip(v * ROWS - 0.5, 0, ROWS - 1.001)
    return Lobe(column, row, dr.clip(level, 0, LEVELS - 1.001), scale, bias)


def patch_around(probes: Any, first: Any, lobe: Lobe) -> Patch:
    """Reads the `ProbeTable.values` of the cell whose probe begins at texel `first`."""
    left, top, below = dr.floor(lobe.column), dr.floor(lobe.row), dr.floor(lobe.level)
    upper, nearer, column = mi.Int32(top), mi.Int32(below), mi.Int32(left)
    column = dr.select(column < 0, column + COLUMNS, column)
    right = dr.select(column + 1 >= COLUMNS, 0, column + 1)

    def at(level: Any, row: Any, column: Any) -> Any:
        index = first + mi.UInt32((level * ROWS + row) * COLUMNS + column)
        return mi.Vector3f(dr.gather(mi.Array3f16, probes, index))  # type: ignore[arg-type]

    def image(level: Any) -> tuple[Any, Any, Any, Any]:
        here, across = at(level, upper, column), at(level, upper, right)
        down, both = at(level, upper + 1, column), at(level, upper + 1, right)
        return here, across - here, down - here, both - across - down + here

    return Patch(lobe, left, top, below, (image(nearer), image(nearer + 1)))


def gathered(patch: Patch, lobe: Lobe) -> Any:
    """Mean radiance in a lobe on a patch or beside it, not negative."""
    away = lobe.column - patch.lobe.column
    away -= COLUMNS * dr.round(away / COLUMNS)
    across = patch.lobe.column - patch.left + dr.clip(away, -FARTHEST, FARTHEST)
    down = lobe.row - patch.top
    near, far = (here + across * x + down * (y + across * xy) for here, x, y, xy in patch.images)
    return dr.maximum(dr.lerp(near, far, lobe.level - patch.below), 0)
