"""A sheet of printed markers: its layout in metres and its picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hir_plugins.initializers.markers.marker_detection import DICTIONARIES

QUIET_ZONE = 0.25
"""White border around a marker, as a fraction of its side; detectors need it."""


@dataclass(frozen=True)
class MarkerSheet:
    """Markers number 0, 1, … along the sheet's border; its middle is free for the object."""

    columns: int
    rows: int
    side: float
    """Of a marker's black square, in metres."""
    pitch: float
    """Distance between the centres of neighbouring markers, in metres."""
    dictionary: str = "aruco_4x4"

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        border = self.side * (1 + 2 * QUIET_ZONE)
        return (self.columns - 1) * self.pitch + border, (self.rows - 1) * self.pitch + border

    @property
    def positions(self) -> list[tuple[float, float]]:
        """Upper left corner of each black square, in metres from the sheet's upper left corner."""
        cells = [
            (x, y)
            for y in range(self.rows)
            for x in range(self.columns)
            if x in (0, self.columns - 1) or y in (0, self.rows - 1)
        ]
        first = QUIET_ZONE * self.side
        return [(first + x * self.pitch, first + y * self.pitch) for x, y in cells]

    def picture(self, pixels_per_metre: float) -> NDArray[np.uint8]:
        """The sheet (H, W), black on white, whole pixels a marker."""
        width, height = (round(length * pixels_per_metre) for length in self.size)
        sheet = np.full((height, width), 255, np.uint8)
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])
        side = round(self.side * pixels_per_metre)
        for number, (x, y) in enumerate(self.positions):
            left, top = round(x * pixels_per_metre), round(y * pixels_per_metre)
            sheet[top : top + side, left : left + side] = dictionary.generateImageMarker(number, side)
        return sheet
