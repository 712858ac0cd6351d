"""Options of the regularizers that use only the shape of the mesh."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LaplacianOptions:
    """Squared offsets of the vertices from their neighbours."""

    cotangent: bool = False
    """Weigh neighbours by cotangents instead of equally."""
    scale_free: bool = False
    """Measure the bending energy ∫ |Δx|² dA (Willmore's, times 4), which knows neither the scene's scale nor the
    mesh's resolution.
    """


@dataclass(frozen=True)
class EdgeLengthOptions:
    """The root of the summed squares of all edges' lengths."""

    scale_free: bool = False
    """Relative to its value at the start of the stage."""
