"""Options of the regularizers of material and light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval


@dataclass(frozen=True)
class BilateralOptions:
    """Options of both bilateral terms."""

    sigma_position: Annotated[float, Interval(gt=0)] = 0.04
    """σ1 as a fraction of the diagonal of the mesh's bounds."""
    samples: Literal["vertices", "texels"] = "vertices"
    """Samples of the sum: vertices, or texels of the finest texture."""
    method: Literal["grid", "all_pairs"] = "grid"
    """`grid`: an adaptive bilateral grid, linear in the number of samples. `all_pairs`: the definition, quadratic."""
    cutoff: Annotated[float, Interval(gt=0)] = 3.0
    """Samples at a greater distance, in σ1, are left out."""
    cell_size: Annotated[float, Interval(gt=0)] = 0.75
    """Edge of the grid's cells, in σ of positions and of guiding values; docs/regularizers.md has error and time."""


@dataclass(frozen=True)
class BilateralSpecularOptions(BilateralOptions):
    """The paper's smoothness of specular albedo (Zhu et al. 2023)."""

    sigma_albedo: Annotated[float, Interval(gt=0)] = 0.1
    """σ2: difference of linear diffuse albedo, as the length of its RGB vector."""
    average: bool = False
    """Divide by the number of samples, so that the weight does not depend on the resolution (the paper: the sum)."""


@dataclass(frozen=True)
class JointBilateralOptions(BilateralOptions):
    """Widths of the maps, and relative weights of what is smoothed; a map of weight 0 still guides the others."""

    samples: Literal["vertices", "texels"] = "texels"
    """Samples of the mean: vertices, or texels of the finest texture."""
    sigma_diffuse: Annotated[float, Interval(gt=0)] = 0.1
    """Difference of linear diffuse albedo, as the length of its RGB vector."""
    sigma_specular: Annotated[float, Interval(gt=0)] = 0.05
    """Difference of specular albedo."""
    sigma_roughness: Annotated[float, Interval(gt=0)] = 0.1
    """Difference of roughness (GGX α)."""
    diffuse_albedo: Annotated[float, Interval(ge=0)] = 1.0
    """Weight of the diffuse albedo."""
    specular_albedo: Annotated[float, Interval(ge=0)] = 1.0
    """Weight of the specular albedo."""
    roughness: Annotated[float, Interval(ge=0)] = 1.0
    """Weight of the roughness."""


@dataclass(frozen=True)
class AlbedoScaleOptions:
    """Fixes the factor between albedo and light, which photographs do not determine."""

    per_channel: bool = False
    """Fix the mean of each channel, not only the mean of all."""


@dataclass(frozen=True)
class TotalVariationOptions:
    """Relative weights of the parts; 0 leaves one out."""

    diffuse_albedo: Annotated[float, Interval(ge=0)] = 1.0
    """Of the diffuse albedo's texture."""
    specular_albedo: Annotated[float, Interval(ge=0)] = 1.0
    """Of the specular albedo's texture."""
    roughness: Annotated[float, Interval(ge=0)] = 1.0
    """Of the roughness texture (GGX α)."""
    environment: Annotated[float, Interval(ge=0)] = 0.0
    """Of the light."""
    samples: Literal["texels", "vertices"] = "texels"
    """`texels`: between neighbouring texels of a chart. `vertices`: of the values at the vertices, over the triangles
    and across seams."""
