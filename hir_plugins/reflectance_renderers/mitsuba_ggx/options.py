"""Options of the path tracer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MitsubaGGXOptions:
    """The path tracer."""

    samples: int = 16
    """Paths for each pixel of a step of a fit."""
    gradient_samples: int = 0
    """Paths for each pixel of the derivative, independent of those of the value; 0: as many as `samples`."""
    render_samples: int = 256
    """Paths for each pixel of a picture. Under a sunny sky 64 leave noise of 33 dB over object pixels, 256 of 40 dB."""
    max_depth: int = 3
    """Mitsuba's count: 2 is direct light, 3 one reflection between parts of the object."""
