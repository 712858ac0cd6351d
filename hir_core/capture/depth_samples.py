"""Which depths of a sensor can be used, and how noisy they are."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.camera import Camera
from hir_core.capture.measured_depth import DepthPixels

_MAX_TANGENT: Final = 6.0
"""A depth whose neighbours are further away than on a surface of this slope lies at an edge: sensors mix both sides."""

_EDGE_NOISE: Final = 4.0
"""Standard deviations of noise that a difference between neighbours must exceed to be an edge."""


def usable_depths(camera: Camera, pixels: DepthPixels, noise: float) -> NDArray[np.bool_]:
    """Where (H, W) a depth is known and not at an edge; `camera` is that of the depth map."""
    usable = _known(pixels)
    return usable & ~_at_edge(camera, pixels.depth, usable, noise)


def depth_noise(pixels: DepthPixels) -> float:
    """Standard deviation of independent errors of depths, from their second differences; 0 without three in a row.

    Second differences of a smooth surface are small against those of noise, whose variance they have six times. Errors
    that neighbours share do not show in them.
    """
    from scipy.stats import median_abs_deviation

    depth = pixels.depth.astype(np.float64)
    usable = _known(pixels)
    bends = []
    for axis in (0, 1):
        d, known = np.moveaxis(depth, axis, 0), np.moveaxis(usable, axis, 0)
        bend = d[2:] - 2 * d[1:-1] + d[:-2]
        bends.append(bend[known[2:] & known[1:-1] & known[:-2]])
    values = np.concatenate(bends)
    return float(median_abs_deviation(values, scale="normal")) / math.sqrt(6) if len(values) else 0.0


def _known(pixels: DepthPixels) -> NDArray[np.bool_]:
    return (pixels.depth > 0) & (pixels.confidence > 0)


def _at_edge(camera: Camera, depth: NDArray[np.float32], usable: NDArray[np.bool_], noise: float) -> NDArray[np.bool_]:
    """Where (H, W) a neighbour is nearer or further away by more than a surface seen obliquely explains."""
    from scipy.ndimage import maximum_filter, minimum_filter

    low = minimum_filter(np.where(usable, depth, np.float32(np.inf)), 3)
    high = maximum_filter(np.where(usable, depth, np.float32(0)), 3)
    footprint = depth / np.float32(camera.intrinsics[0, 0])
    return np.asarray(np.maximum(high - depth, depth - low) > _MAX_TANGENT * footprint + _EDGE_NOISE * noise)
