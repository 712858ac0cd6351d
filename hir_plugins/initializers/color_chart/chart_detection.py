"""A ColorChecker (the chart with 24 patches) in photographs, by OpenCV's detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from hir_core.capture import Array, Pixels, View
from hir_plugins.initializers.markers.patch_colors import (
    MAX_OBJECT_COVERAGE,
    POINTS,
    patch_color,
    sampled,
)

COLUMNS, ROWS = 6, 4
GRID_POSITIONS = np.stack([each.ravel() for each in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))], axis=1).astype(
    np.float64
)
"""Column and row (24, 2) of each patch."""
HALF_OF_PATCH = 0.28
"""In distances between patches: as much of a patch is read to each side of its centre. It leaves room for the gaps
between patches, which differ between the sizes of the chart."""
GREYS = slice(19, 23)
"""The four greys between white and black. White is often clipped, and it was made otherwise before November 2014; black
shows the lens's flare."""
MAX_COLOR_DIFFERENCE = 0.12
"""Mean difference in sRGB (0…1) between the patches and their colours, after the white balance of the greys: a set of
other rectangles is not the chart. In twelve rendered photographs it is at most 0.04; in those with exchanged channels,
which OpenCV takes for the chart too, at least 0.17."""
DETECTED_SIDE = 1600
"""Longer side in pixels to which photographs are reduced for the detector: its time grows with the pixels."""
REFINEMENTS = 3
SAME_COLOR = 14
"""Largest difference in 8-bit sRGB within a patch."""
MIN_AREA_OF_CELL = 0.3
"""Least area of a patch in a photograph, as a share of its cell with the gaps around it."""
MIN_PATCHES = 10
"""Of 24, whose centres are found and agree."""
MIN_GREYS = 2
"""Of these: they give the white balance by which the colours are compared."""
MAX_ERROR_OF_PITCH = 0.08
"""Largest distance of a patch's centre from where the others have it, in distances between patches."""
WHITE_QUANTILE = 0.99
"""Of the linear values: it is shown as white."""


@dataclass(frozen=True, eq=False)
class SeenChart:
    """The chart in one photograph."""

    homography: Float[NDArray[np.float64], "3 3"]
    """From (column, row) of a patch, its centre at whole numbers and dark skin at (0, 0), to pixels without lens
    distortion whose centres are at ½."""
    known: Bool[NDArray[np.bool_], " 24"]
    """Patches that are seen whole; the object may hide the others."""

    def at(self, positions: Array) -> Array:
        """Pixels (N, 2) of positions (N, 2) in columns and rows."""
        return _projected(self.homography, positions)

    def grid(self, patch: int) -> Array:
        """Pixels (`POINTS`², 2) inside a patch, away from its edges."""
        row, column = divmod(patch, COLUMNS)
        along = np.linspace(-HALF_OF_PATCH, HALF_OF_PATCH, POINTS)
        x, y = np.meshgrid(along + column, along + row)
        return self.at(np.stack([x.ravel(), y.ravel()], axis=1))

    @property
    def pitch(self) -> float:
        """Mean distance in pixels between the centres of neighbouring patches."""
        rows = self.at(GRID_POSITIONS).reshape(ROWS, COLUMNS, 2)
        steps = [np.linalg.norm(np.diff(rows, axis=axis), axis=2).mean() for axis in (0, 1)]
        return float(np.mean(steps))


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
    linear = pixels.color_linear
    scale = min(1.0, DETECTED_SIDE / max(linear.shape[:2]))
    if scale < 1:
        linear = np.asarray(cv2.resize(linear, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32)
    picture = _shown(linear)
    detector = _detector()
    if not detector.process(np.ascontiguousarray(picture[..., ::-1]), 1):
        return None
    for found in detector.getListColorChecker():
        centers = found.getColorCharts().astype(np.float64).reshape(-1, 4, 2).mean(axis=1)
        if len(centers) != COLUMNS * ROWS:
            continue
        refined = _refined(picture, centers)
        if refined is None:
            continue
        to_photograph = np.array([[1 / scale, 0, 0.5 / scale], [0, 1 / scale, 0.5 / scale], [0, 0, 1]])
        chart = SeenChart(to_photograph @ refined[0], refined[1])
        if _has_its_colors(chart, pixels):
            return chart
    return None


def shows_chart(views: Sequence[View], count: int) -> bool:
    """Whether two photographs show the chart and one of them is among `count` evenly spaced ones.

    The others are searched only where exactly one of these shows it: a chart at flat angles is found in every third.
    """
    chosen = np.unique(np.linspace(0, len(views) - 1, count).round().astype(int)).tolist()
    seen = sum(find_chart(views[i]) is not None for i in chosen)
    if seen != 1:
        return seen > 1
    return any(find_chart(view) is not None for i, view in enumerate(views) if i not in chosen)


def patch_colors(chart: SeenChart, pixels: Pixels) -> Array:
    """Linear colours (24, 3) of the patches; NaN where a patch is not seen well."""
    found = np.full((COLUMNS * ROWS, 3), np.nan)
    for patch in np.flatnonzero(chart.known):
        if (color := patch_color(pixels, chart.grid(int(patch)))) is not None:
            found[patch] = color
    return found


def _detector() -> Any:
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    return detector


def _has_its_colors(chart: SeenChart, pixels: Pixels) -> bool:
    patches = np.flatnonzero(chart.known)
    colors = np.array([sampled(pixels.color_linear, chart.grid(int(i))).mean(axis=0) for i in patches])
    reference = reference_colors()[patches]
    grey = (patches >= GREYS.start) & (patches < GREYS.stop)
    if grey.sum() < MIN_GREYS or not (np.isfinite(colors).all() and (colors[grey] > 0).all()):
        return False
    balanced = colors / np.median(colors[grey] / reference[grey], axis=0)
    difference = linear_to_srgb(balanced.clip(0, 1)) - linear_to_srgb(reference)
    return float(np.abs(difference).mean()) < MAX_COLOR_DIFFERENCE


def _refined(picture: NDArray[np.uint8], centers: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """A homography through the centres of the patches, and those that it explains; None where these are too few.

    The detector is wrong by up to a patch. Each of its positions is a seed: the area of one colour around it is the
    patch.
    """
    smooth = np.ascontiguousarray(cv2.medianBlur(picture, 3), np.uint8)
    homography, agrees = _homography(GRID_POSITIONS, centers, float(max(picture.shape)))
    for _ in range(REFINEMENTS):
        if homography is None:
            return None
        seeds = _projected(homography, GRID_POSITIONS)
        cells = _cell_areas(homography)
        found = np.full((len(GRID_POSITIONS), 2), np.nan)
        for patch, (seed, cell) in enumerate(zip(seeds, cells, strict=True)):
            if (center := _center_of_color(smooth, seed, cell)) is not None:
                found[patch] = center
        known = np.isfinite(found[:, 0])
        if known.sum() < MIN_PATCHES:
            return None
        limit = MAX_ERROR_OF_PITCH * float(np.sqrt(np.median(cells)))
        homography, agrees = _homography(GRID_POSITIONS[known], found[known], limit)
    if homography is None or agrees.sum() < MIN_PATCHES:
        return None
    known[known] = agrees
    return homography, known


def _homography(positions: Array, seen: Array, limit: float) -> tuple[Array | None, NDArray[np.bool_]]:
    """The homography that most positions agree with to `limit` pixels (None where there is none), and which do."""
    found, agrees = cv2.findHomography(positions, seen, cv2.RANSAC, limit)
    if found is None or not np.isfinite(found).all():
        return None, np.zeros(len(positions), bool)
    return np.asarray(found, np.float64), np.asarray(agrees).reshape(-1) > 0


def _center_of_color(picture: NDArray[np.uint8], seed: Array, cell: float) -> Array | None:
    """The centre of the area that has the colour of the seed; None where it is not as large as a patch."""
    height, width = picture.shape[:2]
    x, y = np.rint(seed).astype(int)
    if not (0 <= x < width and 0 <= y < height):
        return None
    reach = int(1.5 * np.sqrt(cell)) + 2
    left, top = max(0, x - reach), max(0, y - reach)
    window = np.ascontiguousarray(picture[top : y + reach + 1, left : x + reach + 1])
    area = np.zeros((window.shape[0] + 2, window.shape[1] + 2), np.uint8)
    flags = 4 | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE | (1 << 8)
    tolerance = (SAME_COLOR,) * 3
    count, *_ = cv2.floodFill(window, area, (int(x - left), int(y - top)), 0, tolerance, tolerance, flags)
    if not MIN_AREA_OF_CELL * cell < count < cell:
        return None
    rows, columns = np.nonzero(area[1:-1, 1:-1])
    return np.array([columns.mean() + left, rows.mean() + top])


def _cell_areas(homography: Array) -> Array:
    """Area in pixels (24,) of the cell of each patch, from its centre to those of its neighbours."""
    half = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = _projected(homography, (GRID_POSITIONS[:, None] + half).reshape(-1, 2)).reshape(-1, 4, 2)
    x, y = corners[..., 0], corners[..., 1]
    return np.asarray(0.5 * np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)))


def _projected(homography: Array, positions: Array) -> Array:
    return np.asarray(cv2.perspectiveTransform(positions[None].astype(np.float64), homography)[0])


def _shown(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear values as an sRGB picture (H, W, 3), as bright as the detector expects."""
    white = max(float(np.quantile(linear, WHITE_QUANTILE)), 1e-6)
    shown = linear_to_srgb((linear / white).clip(0, 1))
    return np.asarray(255 * shown + 0.5).astype(np.uint8)
