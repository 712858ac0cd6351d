"""Options of the four components."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LightChromaOptions:
    """Of light_chroma."""

    floor: float = 0.05
    """Radiance below which a texel's tint counts less."""


@dataclass(frozen=True)
class MidpointOptions:
    """Of midpoint_outline."""

    samples: int = 4
    """Samples a pixel along each direction."""


@dataclass(frozen=True)
class SupersampledOptions:
    """Of supersampled."""

    max_depth: int = 2
    """Maximum path length of the wrapped mitsuba_ggx: 2 is direct light, 3 one bounce."""
    factor: int = 2
    """Pictures are rendered this many times larger and averaged."""


@dataclass(frozen=True)
class PlyOptions:
    """Of ply."""

    color: str = "diffuse_albedo"
    """Which texture becomes the vertices' colour: diffuse_albedo or specular_albedo."""
