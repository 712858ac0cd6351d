"""Initializer: metres, the horizontal and irradiance from printed markers that lie beside the object."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np

from hir_core.capture import Array, Capture
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_core.scene.frames import move_scene
from hir_plugins.initializers.markers.card_photographs import measured_irradiance
from hir_plugins.initializers.markers.marker_detection import DICTIONARIES, find_dictionary, seen_markers
from hir_plugins.initializers.markers.marker_geometry import (
    MAX_DEGREES_FROM_VERTICAL,
    Corners,
    corners_in_space,
    front_of_markers,
    levelling_rotation,
    scale_of_markers,
)
from hir_plugins.initializers.options import FiducialMarkersOptions

MAX_RELATIVE_DEVIATION = 0.02
"""Relative deviation of the measured sides above which a warning says so."""
SETTING = "initializer.fiducial_markers"


@final
class FiducialMarkers(Initializer):
    """Scales the world to metres and levels it, by markers of known size that the photographs show.

    Corners are found to a fraction of a pixel, intersected over all photographs, and photographs that disagree are left
    out. Needs cameras; the order is structure from motion, markers, surface. The markers of a card from `hir card` also
    give the irradiance on it (`Capture.irradiance`).

    Of several takes the photographs of the first one are used: markers beside the object move against it between takes.
    """

    def __init__(self, config: FiducialMarkersOptions) -> None:
        self._config = config
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture (and the scene) in metres and upright, with what a card shows of the light.

        Without a marker in two photographs: `CaptureError`. Without the side of the markers: `ConfigError`.
        """
        del workspace
        side = self._config.side
        if not (np.isfinite(side) and side > 0):
            raise ConfigError(
                f"{SETTING}.side is {side:g}; measure the side of a marker's black square and set it in metres, "
                f"such as: --set {SETTING}.side=0.04"
            )
        if not (self._config.paper_reflectance == 0 or 0.02 <= self._config.paper_reflectance <= 1):
            raise ConfigError(
                f"{SETTING}.paper_reflectance is {self._config.paper_reflectance:g}; give 0.02 to 1, such as 0.85 for "
                "office paper, or 0 for no brightness from the card"
            )
        takes = capture.takes
        first = replace(capture, views=tuple(view for view in capture.views if view.take == takes[0]))
        in_first = zip(capture.views, capture.cameras, strict=True)
        cameras = [camera for view, camera in in_first if view.take == takes[0]]
        dictionary = self._config.dictionary
        found = find_dictionary(first.views) if dictionary == "auto" else dictionary
        seen, repeated = seen_markers(first.views, found) if found is not None else ({}, set())
        if repeated:
            warnings.warn(
                f"markers {sorted(repeated)} lie twice in one photograph and are not used; print every number once",
                stacklevel=2,
            )
        corners = {n: c for n, each in seen.items() if (c := corners_in_space(each, cameras)) is not None}
        if not corners:
            where = f" in the photographs of the first take, {takes[0]}," if len(takes) > 1 else ""
            raise CaptureError(f"{capture.path}:{where} {_nothing_found(len(seen), found)}")
        scale = scale_of_markers(corners, side)
        if scale.relative_deviation > MAX_RELATIVE_DEVIATION:
            warnings.warn(
                f"the sides of {scale.markers} markers differ by {scale.relative_deviation:.1%}; print them on one "
                "sheet, lay it flat, and take sharp photographs in which they are larger",
                stacklevel=2,
            )
        paper = self._config.paper_reflectance
        irradiance = measured_irradiance(first, corners, paper) if paper > 0 else None
        turn, level = self._level(corners)
        self._report = {
            "scale_from": f"{scale.markers} markers ({found}) of {side:g} m, "
            f"whose sides differ by {scale.relative_deviation:.2%}",
            "relative_deviation_of_sides": round(scale.relative_deviation, 5),
            "level": level,
        }
        if irradiance is not None:
            self._report["card"] = {
                "photographs": len(irradiance.values),
                "irradiance": [round(value, 5) for value in irradiance.mean],
                "relative_deviation": round(irradiance.relative_deviation, 5),
                "paper_reflectance": paper,
            }
            capture = replace(capture, irradiance=irradiance)
        metres = scale.metres_per_unit
        transform = np.diag([metres, metres, metres, 1.0]) @ turn
        return capture.transformed(transform), None if scene is None else move_scene(scene, transform)

    def report(self) -> Mapping[str, object]:
        """The source of the scale, its spread, what was levelled, and what a card showed."""
        return self._report

    def _level(self, corners: Mapping[int, Corners]) -> tuple[Array, str]:
        """The rotation to the horizontal, and what happened, for the report."""
        if not self._config.level:
            return np.eye(4), "kept: level is false"
        front = front_of_markers(corners)
        if front is None:
            return np.eye(4), "kept: the markers do not lie in one plane"
        turn, degrees = levelling_rotation(front)
        if degrees > MAX_DEGREES_FROM_VERTICAL:
            return np.eye(4), f"kept: the markers' plane is {degrees:.0f} degrees from the horizontal"
        return turn, f"turned by {degrees:.2f} degrees to the markers' plane"


def _nothing_found(seen: int, dictionary: str | None) -> str:
    if seen:
        return (
            f"{seen} markers ({dictionary}) are seen in two photographs or more, but photographs and cameras contradict"
            " each other there; markers must not be moved between photographs"
        )
    tried = f"of {dictionary}" if dictionary else f"of any known dictionary ({', '.join(DICTIONARIES)})"
    return (
        f"no marker {tried} is seen in two photographs; its sides need 25 pixels or more and a white border, and the "
        "photographs need their background"
    )
