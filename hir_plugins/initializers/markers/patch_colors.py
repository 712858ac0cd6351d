"""The linear colour of a flat patch in a photograph, where the patch is seen well."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Pixels

POINTS, INSET = 9, 0.2
"""Samples along a side of a patch, and the border that is left out, as a fraction of its side: lenses blur edges."""
BLOCKS = 3
"""Along a side of a patch; means over a block have less noise than samples."""
MIN_PATCH_PIXELS = 6.0
"""Shortest side of a patch in a photograph."""
MIN_COSINE = 0.35
"""Between the card's normal and the direction to the camera: at grazing angles paper is glossy."""
MAX_UNEVENNESS = 0.1
"""Standard deviation over the mean of a patch's blocks: more is a shadow's edge, gloss, or something in front."""
MAX_OBJECT_COVERAGE = 0.01
DARKEST = 1e-4
"""Linear colours below are noise."""


def patch_color(pixels: Pixels, at: Array) -> Array | None:
    """Linear colour (3,) of a patch; None where it is small, clipped, uneven, or covered by the object.

    `at`: pixels (`POINTS`², 2) of a grid of samples inside the patch, row by row; pixel centres at ½.
    """
    if _shortest_side(at) < MIN_PATCH_PIXELS:
        return None
    hidden = pixels.mask is not None and sampled(pixels.mask, at).max() > MAX_OBJECT_COVERAGE
    if hidden or sampled(pixels.saturated.astype(np.float32), at).max() > 0:
        return None
    color = sampled(pixels.color_linear, at)
    blocks = color.reshape(BLOCKS, POINTS // BLOCKS, BLOCKS, POINTS // BLOCKS, 3).mean(axis=(1, 3)).reshape(-1, 3)
    mean = blocks.mean(axis=0)
    if (mean > DARKEST).all() and (blocks.std(axis=0) < MAX_UNEVENNESS * mean).all():
        return np.asarray(np.median(blocks, axis=0))
    return None


def sampled(image: NDArray[np.float32], at: Array) -> Array:
    """Bilinear values at pixel positions whose centres are at ½."""
    position = (at - 0.5).astype(np.float32)
    found = cv2.remap(image, position[:, None, 0], position[:, None, 1], cv2.INTER_LINEAR)
    return np.asarray(found[:, 0], dtype=np.float64)


def _shortest_side(at: Array) -> float:
    """Of a patch in pixels, from its grid of samples."""
    grid = at.reshape(POINTS, POINTS, 2)
    sides = np.linalg.norm(grid[0, -1] - grid[0, 0]), np.linalg.norm(grid[-1, 0] - grid[0, 0])
    return float(min(sides)) / (1 - 2 * INSET)
