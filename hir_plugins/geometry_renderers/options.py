"""Options of the built-in geometry renderers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval, Unit


@dataclass(frozen=True)
class ContourOptions:
    """Exact outlines along rows and columns of pixels."""

    lines_per_pixel: Annotated[int, Interval(ge=1)] = 1
    """Rows and columns per pixel on which `overlap` measures; 1 samples the outline about once in each pixel."""
    render_lines: Annotated[int, Interval(ge=1)] = 4
    """Rows and columns per pixel of `render`; coverage is exact along each line."""


@dataclass(frozen=True)
class SoftSilhouetteOptions:
    """SoftRas' silhouettes (Liu et al. 2019), in normalised device coordinates (the longer side is 2)."""

    sigma: Annotated[float, Interval(gt=0)] = 1e-4
    """Softness of the edge: the sigmoid's argument is distance² / σ."""
    cutoff: Annotated[float, Interval(ge=0, lt=1)] = 1e-4
    """A triangle whose own coverage is below this counts as nothing."""
    band: Annotated[int, Interval(ge=0), Unit("pixels")] = 0
    """Only pixels within this many pixels of the outline carry gradient; 0: all pixels."""
    tile: Annotated[int, Interval(ge=1), Unit("pixels")] = 4
    """Side of the square tiles in which triangles are gathered."""
