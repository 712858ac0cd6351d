"""Options of `transport_ggx`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from hir_core.plugins.options import seed_of_run, takes_effect_with


@dataclass(frozen=True)
class TransportGGXOptions:
    """Options that trade speed for error; docs/reflectance.md has measurements."""

    steps: Annotated[int, Interval(ge=1)] = takes_effect_with(200, "solver")
    """Steps of a full fit of one model. A round of model selection takes 20 or 40 % of them, a refinement 30 %."""
    pixels: Annotated[int, Interval(ge=1)] = takes_effect_with(240_000, "solver")
    """Pixels of all views together that light and model are fitted to."""
    pixels_per_value: Annotated[float, Interval(ge=0, le=1000)] = takes_effect_with(2.5, "solver")
    """Pixels of a fit for each value of a map at vertices, about, at least: where there are fewer, values of
    neighbouring vertices change together, and an albedo cannot show highlights of the few photographs that see it. 0
    for a value at each vertex (docs/studies/values_of_maps.md)."""
    samples: Annotated[int, Interval(ge=1)] = 16
    """Directions of each pixel's specular lobe."""
    diffuse_samples: Annotated[int, Interval(ge=1)] = 96
    """Directions of each pixel's hemisphere, where the light moves with the camera."""
    cache_cells: Annotated[int, Interval(ge=1)] = 6_000
    """Cells of the irradiance cache, about, at most."""
    vertices: Annotated[int, Interval(ge=0)] = 40_000
    """Coarser meshes are subdivided to about this many vertices; each has an albedo while the light is fitted."""
    diffuse_rows: Annotated[int, Interval(ge=1)] = 32
    """Rows of the light that the diffuse part uses; the specular part uses all."""
    texture_pixels: Annotated[int, Interval(ge=1)] = takes_effect_with(2_500_000, "solver")
    """Pixels of all views together that textures are solved from."""
    texture_samples: Annotated[int, Interval(ge=1)] = takes_effect_with(8, "solver")
    """Directions of each pixel's lobe while textures are solved: errors average out over the pixels of a texel."""
    light_smoothness: Annotated[float, Interval(ge=0)] = takes_effect_with(1e-4, "solver", "fitted light")
    """Weight of differences between neighbouring texels of the light's logarithm."""
    light_whiteness: Annotated[float, Interval(ge=0)] = takes_effect_with(1e-3, "solver", "fitted light")
    """Weight of the light's chroma: a tint is attributed to the surface rather than to the light."""
    initial_albedo: Literal["uniform", "photographs"] = takes_effect_with("uniform", "solver", "fitted light")
    """Initial albedo of a fit: one for all vertices, or each vertex's colour divided by its irradiance, which contains
    shading. A known light always uses the second."""
    albedo_smoothness: Annotated[float, Interval(ge=0)] = takes_effect_with(1e-3, "solver")
    """Weight of differences of log albedo between neighbouring vertices while the light is fitted; robust to edges."""
    albedo_entropy: Annotated[float, Interval(ge=0, le=1)] = takes_effect_with(3e-5, "solver", "fitted light")
    """Weight of the entropy of the albedo at the first step of each fit before the last one, 0 at its end: it prefers
    few different colours to an albedo that contains shading (docs/studies/albedo_entropy.md)."""
    metalness_prior: Annotated[float, Interval(ge=0)] = takes_effect_with(1e-3, "solver")
    """Weight of 4·m·(1 − m), averaged over vertices, in the fit of metal and dielectric: it draws metalness m to 0 or
    to 1. The photographs' term is a mean of half squared sRGB errors."""
    block_pixels: Annotated[int, Interval(ge=1)] = takes_effect_with(65_536, "solver")
    """Pixels of a gradient step."""
    resident_pixels: Annotated[int, Interval(ge=1)] = takes_effect_with(262_144, "solver")
    """Pixels whose lobes are in memory at once, about 2 kB each. If `pixels` is larger, mini-batches take turns and
    their lobes are drawn again, which costs time instead of memory."""
    render_samples: Annotated[int, Interval(ge=1)] = 32
    """Directions of each pixel's lobe in `render`."""
    supersampling: Annotated[int, Interval(ge=1, le=64)] = 2
    """Rays across a pixel, in each direction, in `render`."""
    seed: int = seed_of_run()
    """Seed of the directions and pixels that are drawn; the run's, unless it is set."""
