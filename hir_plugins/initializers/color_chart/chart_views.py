"""Photographs of a ColorChecker by formula, for tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hir_core.capture import Array
from hir_plugins.initializers.color_chart.chart_detection import COLUMNS, ROWS, reference_colors

GAP = 0.15
"""Between patches and around them, in sides of a patch."""
FRAME = 0.03
"""Linear value of what lies between the patches."""


@dataclass(frozen=True)
class ColorCheckerSheet:
    """The chart at one size."""

    side: float
    """Of a patch, in metres."""

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        return (COLUMNS * (1 + GAP) + GAP) * self.side, (ROWS * (1 + GAP) + GAP) * self.side

    def picture(self, pixels_per_metre: float) -> Array:
        """The chart (H, W, 3), linear reflectances."""
        scale = self.side * pixels_per_metre
        width, height = (round(each * pixels_per_metre) for each in self.size)
        picture = np.full((height, width, 3), FRAME)
        for patch, color in enumerate(reference_colors()):
            row, column = divmod(patch, COLUMNS)
            left, top = (GAP + each * (1 + GAP) for each in (column, row))
            rows = slice(round(top * scale), round((top + 1) * scale))
            picture[rows, round(left * scale) : round((left + 1) * scale)] = color
        return picture
