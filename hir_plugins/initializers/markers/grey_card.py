"""The card that `hir card` prints: four markers, and patches of grey between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_plugins.initializers.markers.marker_detection import DICTIONARIES

DICTIONARY = "apriltag_36h11"
MARKERS: Final = (583, 584, 585, 586)
"""The last numbers of the dictionary, clockwise from the upper left: other sheets begin with 0."""
WIDTH, HEIGHT = 5.6, 3.6
"""Of the card, in sides of a marker."""
MARKER_CORNERS: Final = ((0.2, 0.2), (4.4, 0.2), (4.4, 2.4), (0.2, 2.4))
"""Upper left corner of each black square, from the card's upper left corner, x to the right and y down."""
PATCH_SIDE = 0.76
PATCHES: Final = tuple((1.5 + column * 0.92, 0.6 + row * 1.64) for row in range(2) for column in range(3))
"""Upper left corner of each patch. The patches stand at the card's edges: its middle stays free for a small object."""
PATCH_GREYS: Final = (255, 190, 128, 255, 190, 128)
"""sRGB of the patches: bare paper, and two greys that are not clipped where the paper is. What a printer makes of them
is measured in the photographs, beside the paper."""


@dataclass(frozen=True)
class GreyCard:
    """The card at the size at which it is printed."""

    side: float
    """Of a marker's black square, in metres."""

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        return WIDTH * self.side, HEIGHT * self.side

    def picture(self, pixels_per_metre: float) -> NDArray[np.uint8]:
        """The card (H, W), 255 is paper; whole pixels a marker."""
        scale = round(self.side * pixels_per_metre)

        def at(value: float) -> int:
            return round(value * scale)

        card = np.full((at(HEIGHT), at(WIDTH)), 255, np.uint8)
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[DICTIONARY])
        for number, (x, y) in zip(MARKERS, MARKER_CORNERS, strict=True):
            left, top = at(x), at(y)
            card[top : top + scale, left : left + scale] = dictionary.generateImageMarker(number, scale)
        for grey, (x, y) in zip(PATCH_GREYS, PATCHES, strict=True):
            card[at(y) : at(y + PATCH_SIDE), at(x) : at(x + PATCH_SIDE)] = grey
        return card


def corners_on_card(marker: int) -> Array:
    """Corners (4, 2) of a marker's black square, clockwise from its upper left one, in sides from the card's corner."""
    x, y = MARKER_CORNERS[MARKERS.index(marker)]
    return np.array([[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]])


def patch_points(patch: int, count: int, inset: float) -> Array:
    """A grid of `count`² points (count², 2) inside a patch, `inset` of its side away from its edges."""
    along = np.linspace(inset, 1 - inset, count) * PATCH_SIDE
    x, y = np.meshgrid(along + PATCHES[patch][0], along + PATCHES[patch][1])
    return np.stack([x.ravel(), y.ravel()], axis=1)
