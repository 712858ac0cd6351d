"""Options of the built-in geometry renderers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ContourOptions:
    """Exact outlines along rows and columns of pixels."""

    lines_per_pixel: int = 1
    """Rows and columns per pixel on which `overlap` measures; 1 samples the outline about once in each pixel."""
    render_lines: int = 4
    """Rows and columns per pixel of `render`; coverage is exact along each line."""


@dataclass(frozen=True)
class SoftSilhouetteOptions:
    """SoftRas' silhouettes (Liu et al. 2019), in normalised device coordinates (the longer side is 2)."""

    sigma: float = 1e-4
    """Softness of the edge: the sigmoid's argument is distance² / σ."""
    cutoff: float = 1e-4
    """A triangle whose own coverage is below this counts as nothing."""
    band: int = 0
    """Only pixels within this many pixels of the outline carry gradient; 0: all pixels."""
    tile: int = 4
    """Side of the square tiles in which triangles are gathered."""
