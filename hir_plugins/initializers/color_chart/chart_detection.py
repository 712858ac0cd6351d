"""A ColorChecker (the chart with 24 patches) in photographs, by OpenCV's detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from jaxtyping import Float
from numpy.typing import NDArray

from hir_core.capture import Array, Pixels, View
from hir_plugins.initializers.markers.patch_colors import (
    INSET,
    MAX_OBJECT_COVERAGE,
    POINTS,
    patch_color,
    sampled,
)

COLUMNS, ROWS = 6, 4
GREYS = slice(19, 23)
"""The four greys between white and black. White is often clipped, and it was made otherwise before November 2014; black
shows the lens's flare."""
MAX_COLOR_DIFFERENCE = 0.12
"""Mean difference in sRGB (0…1) between the patches and their colours, after the white balance of the greys: a set of
other rectangles is not the chart. Saturated colours under a room's light and a phone's own colours differ by less."""
DETECTED_SIDE = 1600
"""Longer side in pixels to which photographs are reduced for the detector: its time grows with the pixels."""
WHITE_QUANTILE = 0.99
"""Of the linear values: it is shown as white."""


@dataclass(frozen=True, eq=False)
class SeenChart:
    """The chart in one photograph; pixels without lens distortion, pixel centres at ½."""

    patches: Float[NDArray[np.float64], "24 4 2"]
    """Corners of each patch, row by row from dark skin to black."""

    @property
    def corners(self) -> Float[NDArray[np.float64], "4 2"]:
        """Centres of the patches at the corners of the chart, clockwise from dark skin as seen from its front.

        From a homography through the centres of all patches.
        """
        x, y = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
        flat = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
        homography, _ = cv2.findHomography(flat, self.patches.mean(axis=1))
        at_corners = np.array([[[0, 0], [COLUMNS - 1, 0], [COLUMNS - 1, ROWS - 1], [0, ROWS - 1]]], np.float64)
        return np.asarray(cv2.perspectiveTransform(at_corners, homography)[0])

    def grid(self, patch: int) -> Array:
        """Pixels (`POINTS`², 2) inside a patch, away from its edges."""
        along = np.linspace(INSET, 1 - INSET, POINTS)
        x, y = (each.ravel()[:, None] for each in np.meshgrid(along, along))
        a, b, c, d = self.patches[patch]
        return np.asarray((1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * d + x * c))


def can_detect() -> bool:
    """Whether the installed OpenCV has the detector: the wheels of OpenCV 5 do, those of OpenCV 4 do not."""
    return hasattr(cv2, "mcc")


def is_cut_out(pixels: Pixels) -> bool:
    """Whether a photograph has no background around the object."""
    if pixels.mask is None:
        return False
    background = pixels.color_linear[pixels.mask < MAX_OBJECT_COVERAGE]
    return background.size == 0 or bool(np.ptp(background) == 0)


@cache
def reference_colors() -> Array:
    """Linear sRGB reflectance (24, 3) of the patches, from OpenCV's table."""
    codes = _detector().getRefColors().reshape(-1, 3)[:, ::-1]
    return np.asarray(srgb_to_linear(codes / 255.0))


def find_chart(view: View) -> SeenChart | None:
    """The chart in a photograph; None where there is none, or several things look like one and none has its colours."""
    pixels = view.pixels()
    picture = _shown(pixels)
    scale = min(1.0, DETECTED_SIDE / max(picture.shape[:2]))
    if scale < 1:
        picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    detector = _detector()
    if not detector.process(np.ascontiguousarray(picture[..., ::-1]), 1):
        return None
    for found in detector.getListColorChecker():
        patches = (found.getColorCharts().astype(np.float64).reshape(-1, 4, 2) + 0.5) / scale
        chart = SeenChart(patches)
        if len(patches) == COLUMNS * ROWS and _has_its_colors(chart, pixels):
            return chart
    return None


def shows_chart(views: Sequence[View], count: int) -> bool:
    """Whether two of `count` photographs, evenly spaced, show the chart."""
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, count).round().astype(int))]
    seen = 0
    for view in chosen:
        seen += find_chart(view) is not None
        if seen == 2:
            return True
    return False


def grey_colors(chart: SeenChart, pixels: Pixels) -> Array:
    """Linear colours (4, 3) of the greys, from light to dark; NaN where a patch is not seen well."""
    found = np.full((GREYS.stop - GREYS.start, 3), np.nan)
    for row, patch in enumerate(range(GREYS.start, GREYS.stop)):
        if (color := patch_color(pixels, chart.grid(patch))) is not None:
            found[row] = color
    return found


def _detector() -> Any:
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    return detector


def _has_its_colors(chart: SeenChart, pixels: Pixels) -> bool:
    height, width = pixels.saturated.shape
    if (chart.patches < 0.5).any() or (chart.patches > [width - 0.5, height - 0.5]).any():
        return False
    colors = np.array([sampled(pixels.color_linear, chart.grid(i)).mean(axis=0) for i in range(COLUMNS * ROWS)])
    reference = reference_colors()
    if not (np.isfinite(colors).all() and (colors[GREYS] > 0).all()):
        return False
    balanced = colors / np.median(colors[GREYS] / reference[GREYS], axis=0)
    difference = linear_to_srgb(balanced.clip(0, 1)) - linear_to_srgb(reference)
    return float(np.abs(difference).mean()) < MAX_COLOR_DIFFERENCE


def _shown(pixels: Pixels) -> NDArray[np.uint8]:
    """The photograph as an sRGB picture (H, W, 3), as bright as the detector expects."""
    white = max(float(np.quantile(pixels.color_linear, WHITE_QUANTILE)), 1e-6)
    shown = linear_to_srgb((pixels.color_linear / white).clip(0, 1))
    return np.asarray(255 * shown + 0.5).astype(np.uint8)
