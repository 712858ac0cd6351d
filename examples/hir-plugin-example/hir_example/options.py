"""Options of the four components."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval


@dataclass(frozen=True)
class LightChromaOptions:
    """Of light_chroma."""

    floor: Annotated[float, Interval(ge=0)] = 0.05
    """Radiance below which a texel's tint counts less."""


@dataclass(frozen=True)
class MidpointOptions:
    """Of midpoint_outline."""

    samples: Annotated[int, Interval(ge=1, le=64)] = 4
    """Samples a pixel along each direction."""


@dataclass(frozen=True)
class SupersampledOptions:
    """Of supersampled."""

    max_depth: Annotated[int, Interval(ge=2)] = 2
    """Maximum path length of the wrapped mitsuba_ggx: 2 is direct light, 3 one bounce."""
    factor: Annotated[int, Interval(ge=1, le=8)] = 2
    """Pictures are rendered this many times larger and averaged."""


@dataclass(frozen=True)
class PlyOptions:
    """Of ply."""

    color: str = "diffuse_albedo"
    """Which texture becomes the vertices' colour: diffuse_albedo or specular_albedo."""
