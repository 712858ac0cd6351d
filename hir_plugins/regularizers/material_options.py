"""Options of the regularizers of material and light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class BilateralSpecularOptions:
    """The paper's smoothness of specular albedo (Zhu et al. 2023)."""

    sigma_position: float = 0.02
    """σ1 as a fraction of the diagonal of the mesh's bounds."""
    sigma_albedo: float = 0.1
    """σ2: difference of linear diffuse albedo, as the length of its RGB vector."""
    places: Literal["vertices", "texels"] = "vertices"
    """Where the sum is taken: vertices, or texels of the specular texture."""
    method: Literal["neighbours", "all_pairs"] = "neighbours"
    """Sum over places within `cutoff`·σ1, or over all of them (quadratic: the reference)."""
    cutoff: float = 3.0
    """Radius of the neighbourhood in σ1. On white noise, the worst case, against all pairs: 3 changes the value by
    0.2 % and the gradients by 8 %, 4 by 0.01 % and 2.5 %."""
    neighbours: int = 0
    """At most this many neighbours of each place, drawn once at random and weighed accordingly; 0: all of them. A
    limit keeps the value within a few percent but makes the gradient as noisy as the draw."""
    average: bool = False
    """Divide by the number of places, so that the weight does not depend on the resolution (the paper: the sum)."""


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
