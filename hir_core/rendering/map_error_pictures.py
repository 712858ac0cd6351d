"""Pictures of how certain the maps of a run are: standard errors, and why blocks are uncertain."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hir_core.metrics import Image
from hir_core.scene.material_errors import (
    IN_SHADOW,
    OBSERVED,
    OUTSIDE,
    UNDER_HIGHLIGHTS,
    UNDER_OBSERVED,
    MapErrors,
)

SIDE = 512
"""Least side of a picture in pixels."""
BRIGHTEST_ERROR = 0.2
"""Standard error that is shown white; for ρs a tenth of it."""
COLORS = {
    OUTSIDE: (0.10, 0.10, 0.11),
    OBSERVED: (0.45, 0.62, 0.47),
    UNDER_OBSERVED: (0.84, 0.33, 0.28),
    IN_SHADOW: (0.28, 0.40, 0.75),
    UNDER_HIGHLIGHTS: (0.93, 0.78, 0.33),
}
RAMP = np.array([(0.10, 0.12, 0.35), (0.15, 0.45, 0.62), (0.45, 0.72, 0.45), (0.95, 0.85, 0.35), (1.0, 1.0, 1.0)])
"""From an error of 0 to the brightest one."""
PREFIX = "error_"
CONDITION = "map_condition"


def map_error_pictures(errors: MapErrors) -> dict[str, Image]:
    """By file name: each map, and the conditions of the blocks."""
    maps: Mapping[str, NDArray[np.float32]] = {"base_color": errors.base_color.mean(axis=2)} | errors.maps
    pictures = {PREFIX + name: _enlarged(_ramp(values, name)) for name, values in maps.items()}
    return pictures | {CONDITION: _enlarged(_conditions(errors))}


def _ramp(values: NDArray[np.float32], name: str) -> Image:
    brightest = BRIGHTEST_ERROR / 10 if name == "specular" else BRIGHTEST_ERROR
    share = np.clip(np.nan_to_num(values) / brightest, 0, 1)
    stops = np.linspace(0, 1, len(RAMP))
    colors = np.stack([np.interp(share, stops, RAMP[:, channel]) for channel in range(3)], axis=-1)
    return np.where(np.isnan(values)[..., None], COLORS[OUTSIDE], colors).astype(np.float32)


def _conditions(errors: MapErrors) -> Image:
    return np.array([COLORS[code] for code in range(len(COLORS))], np.float32)[errors.condition]


def _enlarged(picture: Image) -> Image:
    factor = max(1, -(-SIDE // max(picture.shape[:2])))
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)
