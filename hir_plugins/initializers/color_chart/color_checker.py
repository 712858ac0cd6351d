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
    COLUMNS,
    GREYS,
    GRID_POSITIONS,
    ROWS,
    can_detect,
    find_chart,
    patch_colors,
    reference_colors,
)
from hir_plugins.initializers.color_chart.chart_geometry import chart_in_space, chart_normal
from hir_plugins.initializers.markers.card_photographs import irradiance_of_patches
from hir_plugins.initializers.markers.marker_detection import MIN_VIEWS
from hir_plugins.initializers.markers.patch_colors import MIN_COSINE
from hir_plugins.initializers.options import ColorCheckerOptions

MAX_RESPONSE_DIFFERENCE = 0.1
"""Of the exponent of the camera's response from 1, below which nothing is said; nor within three standard errors."""
MIN_PATCHES_OF_RESPONSE = 10
"""Of 22, in a photograph: the exponent and the slopes of the light over the chart are fitted to them."""


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
        pose = chart_in_space(charts, cameras)
        if pose is None:
            warnings.warn(
                f"the ColorChecker in {len(charts)} photographs is not in one place beside the object, so its "
                "brightness was not used; it must not move relative to the object",
                stacklevel=2,
            )
            return capture, scene
        front, middle = chart_normal(pose), pose @ np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2, 1])
        colors = np.full((len(views), len(GRID_POSITIONS), 3), np.nan)
        for i, chart in charts.items():
            if _faces(cameras[i], middle, front):
                colors[i] = patch_colors(chart, views[i].pixels())
        reflectance = self._config.reflectance_factor * reference_colors()[GREYS]
        irradiance = irradiance_of_patches(views, colors[:, GREYS], reflectance, front)
        if irradiance is None:
            warnings.warn(
                "the greys of the ColorChecker are clipped, hidden or uneven in all photographs, so it says nothing "
                "about the light: expose less, and lay it flat where no shadow or gloss falls on it",
                stacklevel=2,
            )
            return capture, scene
        response = response_exponent(colors)
        if response is not None and abs(response[0] - 1) > max(MAX_RESPONSE_DIFFERENCE, 3 * response[1]):
            warnings.warn(
                f"the patches of the ColorChecker follow their reflectances to the power of {response[0]:.2f} ± "
                f"{response[1]:.2f}, so the camera's response is not that of sRGB; develop raw files without a "
                "contrast curve, or choose a neutral picture style",
                stacklevel=2,
            )
        self._report = {
            "color_checker": {
                "photographs": len(irradiance.values),
                "irradiance": [round(value, 5) for value in irradiance.mean],
                "relative_deviation": round(irradiance.relative_deviation, 5),
                "response_exponent": None if response is None else [round(value, 4) for value in response],
                "used": capture.irradiance is None,
            }
        }
        return capture if capture.irradiance is not None else replace(capture, irradiance=irradiance), scene

    def report(self) -> Mapping[str, object]:
        """What the chart showed, in how many photographs, and how far they differ."""
        return self._report


def response_exponent(colors: Array) -> tuple[float, float] | None:
    """The power of their reflectances that the patches' colours (views, 24, 3) are, and its standard error.

    1 for a response of sRGB. In each photograph the logarithms of the brightness are linear in those of the
    reflectances, and in column and row: the object shades a part of the chart. The median over photographs that show
    `MIN_PATCHES_OF_RESPONSE`; None where fewer than two do.
    """
    compared = np.setdiff1d(np.arange(len(GRID_POSITIONS)), (GREYS.start - 1, GREYS.stop))  # without white and black
    reference = reference_colors()[compared]
    found = []
    for seen in colors[:, compared]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of photographs without a grey
            balance = np.nanmedian((seen / reference)[np.isin(compared, np.arange(GREYS.start, GREYS.stop))], axis=0)
        known = np.isfinite(seen).all(axis=1)
        if known.sum() < MIN_PATCHES_OF_RESPONSE or not np.isfinite(balance).all():
            continue
        brightness = np.log((seen[known] / balance).mean(axis=1))
        terms = np.column_stack(
            [np.log(reference[known].mean(axis=1)), GRID_POSITIONS[compared][known], np.ones(known.sum())]
        )
        found.append(float(np.linalg.lstsq(terms, brightness, rcond=None)[0][0]))
    if len(found) < MIN_VIEWS:
        return None
    return float(np.median(found)), float(np.std(found, ddof=1) / np.sqrt(len(found)))


def _faces(camera: Camera, middle: Array, front: Array) -> bool:
    """Whether the camera sees the chart from its front, not at a grazing angle."""
    toward = camera.center - middle
    return bool(toward @ front >= MIN_COSINE * np.linalg.norm(toward))
