"""Options of `transport_ggx`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class TransportGGXOptions:
    """Where speed is bought with error; docs/reflectance.md has the measured exchange."""

    steps: int = 200
    """Steps of a full fit of one model; a rung of the ladder takes half."""
    pixels: int = 240_000
    """Pixels of all views together that light and model are fitted to."""
    samples: int = 16
    """Directions of each pixel's specular lobe."""
    diffuse_samples: int = 48
    """Directions of each pixel's hemisphere, where the light moves with the camera."""
    cells: int = 6_000
    """At most about this many places store irradiance."""
    vertices: int = 40_000
    """Coarser meshes are split until they have about this many vertices to hold albedo while the light is fitted."""
    diffuse_rows: int = 32
    """Rows of the light that the diffuse part sees; the specular part sees all."""
    texture_pixels: int = 2_500_000
    """Pixels of all views together that textures are solved from."""
    texture_samples: int = 8
    """Directions of each pixel's lobe while textures are solved: errors average out over the pixels of a texel."""
    light_smoothness: float = 1e-4
    """Weight of differences between neighbouring texels of the light's logarithm."""
    light_whiteness: float = 1e-3
    """Weight of the light's chroma: of two explanations of a tint, the surface's wins."""
    start: Literal["uniform", "photographs"] = "uniform"
    """Albedo that a fit begins with: one for all, or each vertex's colour over its irradiance, shading included; always
    the second under a known light."""
    albedo_smoothness: float = 1e-3
    """Weight of differences of log albedo between neighbouring vertices while light is sought; edges cost little."""
    known_light: bool = False
    """Hold the light as it is given."""
    view_gain: bool = False
    """Fit a brightness of each photograph, where exposures drifted or a cloud passed."""
    block_pixels: int = 65_536
    """Pixels of a gradient step."""
    resident_pixels: int = 262_144
    """Pixels whose lobes are in memory at once, some 3 kB each. Of more `pixels` than that, shares take turns and are
    drawn anew, which costs time instead of memory."""
    render_samples: int = 32
    """Directions of each pixel's lobe in `render`."""
    supersampling: int = 2
    """Rays across a pixel, in each direction, in `render`."""
    seed: int = 0
    """Of the directions that are drawn."""
