"""Initializer: the irradiance that a ColorChecker beside the object shows."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np

from hir_core.capture import Array, Camera, Capture
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.color_chart.chart_detection import (
    GREYS,
    SeenChart,
    can_detect,
    find_chart,
    grey_colors,
    reference_colors,
)
from hir_plugins.initializers.markers.card_photographs import irradiance_of_patches
from hir_plugins.initializers.markers.marker_detection import MIN_VIEWS, SeenMarker
from hir_plugins.initializers.markers.marker_geometry import corners_in_space, front_of_markers
from hir_plugins.initializers.markers.patch_colors import MIN_COSINE
from hir_plugins.initializers.options import ColorCheckerOptions

MAX_ERROR_OF_SIDE = 0.35
"""How far a patch's centre may lie from its projection, in sides of a patch: OpenCV finds the chart to about a tenth of
a side. More is a chart that moved against the object, or a wrong detection."""
MAX_RESPONSE_DIFFERENCE = 0.1
"""Of the exponent of the camera's response from 1, below which nothing is said."""


@final
class ColorChecker(Initializer):
    """Finds a ColorChecker with 24 patches and takes irradiance and white balance from its greys.

    Its patches have known reflectances, so the chart gives the scale between albedo and light, as the card of
    `hir card` does (`Capture.irradiance`). Its size is not known, so it gives no metres. Needs cameras and the
    photographs' background. A capture that has its irradiance from a card keeps it.

    Of several takes the photographs of the first one are used: the chart beside the object moves against it.
    """

    def __init__(self, config: ColorCheckerOptions) -> None:
        self._config = config
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture with what the chart shows of the light, and the unchanged scene.

        Without the chart in two photographs: `CaptureError`. With an OpenCV without its detector: `ConfigError`. A
        chart that moved between photographs is a warning, and the capture is unchanged.
        """
        del workspace
        self._report = {}
        if not can_detect():
            raise ConfigError(
                "the installed OpenCV cannot find a ColorChecker; install version 5 or newer: "
                "pip install -U opencv-python-headless"
            )
        first = capture.takes[0]
        views = [view for view in capture.views if view.take == first]
        in_first = zip(capture.views, capture.cameras, strict=True)
        cameras = [camera for view, camera in in_first if view.take == first]
        charts = {i: chart for i, view in enumerate(views) if (chart := find_chart(view)) is not None}
        if len(charts) < MIN_VIEWS:
            raise CaptureError(
                f"{capture.path}: {'only one' if charts else 'no'} photograph shows a ColorChecker with 24 patches, "
                "and two are needed; show it whole, flat and in focus, with patches of 20 pixels or more, and keep the "
                "background in the photographs"
            )
        side = float(np.median([_side_of_patches(chart) for chart in charts.values()]))
        seen = [SeenMarker(i, 0, chart.corners) for i, chart in charts.items()]
        corners = corners_in_space(seen, cameras, MAX_ERROR_OF_SIDE * side)
        front = None if corners is None else front_of_markers({0: corners})
        if corners is None or front is None:
            warnings.warn(
                f"the ColorChecker in {len(charts)} photographs is not in one place beside the object, so its "
                "brightness was not used; it must not move relative to the object",
                stacklevel=2,
            )
            return capture, scene
        middle = corners.mean(axis=0)
        colors = np.full((len(views), GREYS.stop - GREYS.start, 3), np.nan)
        for i, chart in charts.items():
            if _faces(cameras[i], middle, front):
                colors[i] = grey_colors(chart, views[i].pixels())
        reflectance = self._config.reflectance_factor * reference_colors()[GREYS]
        irradiance = irradiance_of_patches(views, colors, reflectance, front)
        if irradiance is None:
            warnings.warn(
                "the greys of the ColorChecker are clipped, hidden or uneven in all photographs, so it says nothing "
                "about the light: expose less, and lay it flat where no shadow or gloss falls on it",
                stacklevel=2,
            )
            return capture, scene
        exponent = response_exponent(colors, reflectance)
        if exponent is not None and abs(exponent - 1) > MAX_RESPONSE_DIFFERENCE:
            warnings.warn(
                f"the greys of the ColorChecker follow their reflectances to the power of {exponent:.2f}, so the "
                "camera's response is not that of sRGB; develop raw files without a contrast curve, or choose a "
                "neutral picture style",
                stacklevel=2,
            )
        self._report = {
            "color_checker": {
                "photographs": len(irradiance.values),
                "irradiance": [round(value, 5) for value in irradiance.mean],
                "relative_deviation": round(irradiance.relative_deviation, 5),
                "response_exponent": None if exponent is None else round(exponent, 4),
                "used": capture.irradiance is None,
            }
        }
        return capture if capture.irradiance is not None else replace(capture, irradiance=irradiance), scene

    def report(self) -> Mapping[str, object]:
        """What the chart showed, in how many photographs, and how far they differ."""
        return self._report


def response_exponent(colors: Array, reflectance: Array) -> float | None:
    """The power of the reflectances (greys, 3) that the colours (views, greys, 3) are; 1 for a response of sRGB.

    The median over the photographs in which all greys are seen well; None where there is none.
    """
    whole = np.isfinite(colors).all(axis=(1, 2))
    if not whole.any():
        return None
    x = np.log(reflectance.mean(axis=1))
    y = np.log(colors[whole].mean(axis=2))
    x = x - x.mean()
    return float(np.median((y - y.mean(axis=1, keepdims=True)) @ x / (x @ x)))


def _faces(camera: Camera, middle: Array, front: Array) -> bool:
    """Whether the camera sees the chart from its front, not at a grazing angle."""
    toward = camera.center - middle
    return bool(toward @ front >= MIN_COSINE * np.linalg.norm(toward))


def _side_of_patches(chart: SeenChart) -> float:
    """Median length of the patches' sides, in pixels."""
    return float(np.median(np.linalg.norm(chart.patches - np.roll(chart.patches, 1, axis=1), axis=2)))
