"""The bilinear lookup for Dr.Jit arrays; `hir_core.scene.bilinear` is the same for torch.

Positions are in texels, with 0 at the centre of the first texel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


@dataclass(frozen=True)
class AxisNeighbours:
    """The two texels around positions along one axis."""

    low: DrJitArray
    high: DrJitArray
    fraction: DrJitArray
    """Weight of `high`; that of `low` is 1 minus it."""


def repeated(position: DrJitArray, count: int | DrJitArray) -> AxisNeighbours:
    """Neighbours along a periodic axis, for positions in −1 … `count` − ½: those of coordinates in 0…1."""
    floor = dr.floor(position)
    low = mi.Int32(floor)
    low = dr.select(low < 0, count - 1, low)
    high = dr.select(low + 1 >= count, 0, low + 1)
    return AxisNeighbours(low, high, position - floor)


def extended(position: DrJitArray, count: int | DrJitArray) -> AxisNeighbours:
    """Neighbours along an axis whose border texels go on outside."""
    floor = dr.floor(position)
    low = mi.Int32(floor)
    return AxisNeighbours(dr.clip(low, 0, count - 1), dr.clip(low + 1, 0, count - 1), position - floor)


def clamped(position: DrJitArray, count: int) -> AxisNeighbours:
    """Neighbours along an axis at whose ends positions are extrapolated; `low` is at most `count` − 2."""
    low = dr.minimum(mi.UInt32(dr.detach(dr.maximum(position, 0))), count - 2)
    return AxisNeighbours(low, low + 1, position - mi.Float(low))


def bilinear(texel: Callable[[DrJitArray, DrJitArray], DrJitArray], x: AxisNeighbours, y: AxisNeighbours) -> DrJitArray:
    """The bilinear value of `texel(row, column)` between the neighbours."""
    upper = dr.lerp(texel(y.low, x.low), texel(y.low, x.high), x.fraction)
    lower = dr.lerp(texel(y.high, x.low), texel(y.high, x.high), x.fraction)
    return dr.lerp(upper, lower, y.fraction)
