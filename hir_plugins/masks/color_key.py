"""Mask source: chroma keying, for a background of one colour."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, final

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.options import ColorKeyOptions

if TYPE_CHECKING:
    from hir_core.scene import Scene

_COLORS: Final = {"black": (0, 0, 0), "white": (1, 1, 1), "green": (0, 0.7, 0.25), "blue": (0, 0.25, 0.7)}


@final
class ColorKey(MaskSource):
    """Pixels that differ from the background's colour, and pixels that they enclose."""

    def __init__(self, config: ColorKeyOptions) -> None:
        self._config = config

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask for each view. With `auto`, borders of several colours in one take raise `CaptureError`."""
        del scene
        images = [view.pixels() for view in capture.views]
        named = self._config.color
        if named == "auto":
            keys = _border_colors([linear_to_srgb(p.color_linear) for p in images], capture)
        else:
            keys = [np.array(_COLORS[named], dtype=np.float64)] * len(images)
        return [self._mask(linear_to_srgb(p.color_linear), key) for p, key in zip(images, keys, strict=True)]

    def _mask(self, encoded: NDArray[np.floating], key: NDArray[np.float64]) -> NDArray[np.float32]:
        from scipy.ndimage import binary_dilation, binary_erosion, label, maximum_filter

        # background is connected to the image border: dark parts of an object before black are not background
        regions, _ = label(np.linalg.norm(np.clip(encoded, 0, 1) - key, axis=2) < self._config.tolerance)
        border = np.unique(np.concatenate([regions[0], regions[-1], regions[:, 0], regions[:, -1]]))
        solid = ~np.isin(regions, border[border > 0])
        # an edge pixel is a linear mix of object and background; the object's colour is the most different one nearby
        distance = np.linalg.norm(srgb_to_linear(np.clip(encoded, 0, 1)) - srgb_to_linear(key), axis=2)
        farthest = maximum_filter(np.where(solid, distance, 0.0), size=5)
        mixed = np.clip(distance / np.maximum(farthest, 1e-9), 0, 1)
        edge = binary_dilation(solid, iterations=1) & ~binary_erosion(solid, iterations=2, border_value=1)
        return np.where(edge, mixed, solid).astype(np.float32)


def _border_colors(images: list[NDArray[np.floating]], capture: Capture) -> list[NDArray[np.float64]]:
    """For each photograph the colour (3,) of the borders of its take: another light gives the background another."""
    numbers = capture.take_numbers
    keys = [
        _border_color([image for image, own in zip(images, numbers, strict=True) if own == take], capture)
        for take in range(len(capture.takes))
    ]
    return [keys[take] for take in numbers]


def _border_color(images: list[NDArray[np.floating]], capture: Capture) -> NDArray[np.float64]:
    """The sRGB colour (3,) of at least 70 % of the photographs' border pixels."""
    if not images:
        raise CaptureError(f"{capture.path} has no photographs")
    borders = [np.concatenate([i[0], i[-1], i[:, 0], i[:, -1]]) for i in images]
    pixels = np.clip(np.concatenate(borders), 0, 1)
    median = np.median(pixels, axis=0).astype(np.float64)
    if (np.linalg.norm(pixels - median, axis=1) < 0.1).mean() < 0.7:
        raise CaptureError(
            f"{capture.path}: the photographs' borders have several colours, so the background's colour is unknown; "
            "set "
            "mask_source.color_key.color, or use another mask source"
        )
    return median
