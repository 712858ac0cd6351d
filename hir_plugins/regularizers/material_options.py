"""Options of the regularizers of material and light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class BilateralOptions:
    """What the bilateral terms share."""

    sigma_position: float = 0.04
    """σ1 as a fraction of the diagonal of the mesh's bounds."""
    places: Literal["vertices", "texels"] = "vertices"
    """Where the sum is taken: vertices, or texels of the texture (of several, the finest)."""
    method: Literal["cells", "all_pairs"] = "cells"
    """What is near and alike taken together, linear in the places; or all pairs, quadratic: the reference."""
    cutoff: float = 3.0
    """What is farther than this many σ1 is left out."""
    cell: float = 0.75
    """Edge of the cells in σ, of places and of what guides them; docs/regularizers.md has error against time."""


@dataclass(frozen=True)
class BilateralSpecularOptions(BilateralOptions):
    """The paper's smoothness of specular albedo (Zhu et al. 2023)."""

    sigma_albedo: float = 0.1
    """σ2: difference of linear diffuse albedo, as the length of its RGB vector."""
    average: bool = False
    """Divide by the number of places, so that the weight does not depend on the resolution (the paper: the sum)."""


@dataclass(frozen=True)
class JointBilateralOptions(BilateralOptions):
    """Widths of the maps, and relative weights of what is smoothed; a map of weight 0 still guides the others."""

    places: Literal["vertices", "texels"] = "texels"
    """Where the mean is taken: vertices, or texels of the finest texture."""
    sigma_diffuse: float = 0.1
    """Difference of linear diffuse albedo, as the length of its RGB vector."""
    sigma_specular: float = 0.05
    """Difference of specular albedo."""
    sigma_roughness: float = 0.1
    """Difference of roughness (GGX α)."""
    diffuse_albedo: float = 1.0
    """Weight of the diffuse albedo."""
    specular_albedo: float = 1.0
    """Weight of the specular albedo."""
    roughness: float = 1.0
    """Weight of the roughness."""


@dataclass(frozen=True)
class AlbedoScaleOptions:
    """The factor between albedo and light, which no photograph tells."""

    per_channel: bool = False
    """Hold the tint too, not only the brightness."""


@dataclass(frozen=True)
class TotalVariationOptions:
    """Relative weights of the parts; 0 leaves one out."""

    diffuse_albedo: float = 1.0
    """Of the diffuse albedo's texture."""
    specular_albedo: float = 1.0
    """Of the specular albedo's texture."""
    roughness: float = 1.0
    """Of the roughness texture (GGX α)."""
    environment: float = 0.0
    """Of the light."""
    places: Literal["texels", "vertices"] = "texels"
    """Between neighbouring texels of a chart; or of the texture at the vertices, over the triangles and their seams."""
