"""Depth maps of a sensor, weighted by confidence, without their edges, at the resolution of the voxels."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from torch.nn.functional import interpolate

from hir_core.capture import Camera, DepthPixels, View
from hir_plugins.initializers.stereo.depth_consistency import DepthMap

_MAX_TANGENT = 6.0
"""A depth whose neighbours are further away than on a surface of this slope lies at an edge: sensors mix both sides."""

_EDGE_NOISE = 4.0
"""Standard deviations of noise that a difference between neighbours must exceed to be an edge."""

_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution with a median absolute deviation of 1."""

MAX_ENLARGEMENT = 8


def sensor_map(view: View, noise: float, min_confidence: float) -> DepthMap | None:
    """The usable depths of a view in world units, enlarged bilinearly to about the photograph's resolution.

    Weights are confidences: also an oblique surface proves that the space before it is empty. None where the view has
    no depth.
    """
    measured = view.measured_depth()
    if measured is None or view.camera is None:
        return None
    camera, pixels = measured
    usable = (pixels.depth > 0) & (pixels.confidence >= min_confidence) & (pixels.confidence > 0)
    usable &= ~_at_edge(camera, pixels.depth, usable, noise)
    weight = np.where(usable, pixels.confidence, 0).astype(np.float32)
    inverse = np.where(usable, 1 / np.maximum(pixels.depth, np.float32(1e-30)), 0).astype(np.float32)
    return _enlarged(camera, inverse, weight, min(MAX_ENLARGEMENT, math.ceil(view.camera.width / camera.width)))


def depth_noise(pixels: DepthPixels, min_confidence: float) -> float:
    """Standard deviation of independent errors of depths, from their second differences; 0 without three in a row.

    Second differences of a smooth surface are small against those of noise, whose variance they have six times. Errors
    that neighbours share do not show in them.
    """
    depth = pixels.depth.astype(np.float64)
    usable = (depth > 0) & (pixels.confidence >= min_confidence) & (pixels.confidence > 0)
    bends = []
    for axis in (0, 1):
        d, known = np.moveaxis(depth, axis, 0), np.moveaxis(usable, axis, 0)
        bend = d[2:] - 2 * d[1:-1] + d[:-2]
        bends.append(bend[known[2:] & known[1:-1] & known[:-2]])
    values = np.concatenate(bends)
    return float(_NORMAL_MAD * np.median(np.abs(values)) / math.sqrt(6)) if len(values) else 0.0


def _at_edge(camera: Camera, depth: NDArray[np.float32], usable: NDArray[np.bool_], noise: float) -> NDArray[np.bool_]:
    """Where (H, W) a neighbour is nearer or further away by more than a surface seen obliquely explains."""
    low = minimum_filter(np.where(usable, depth, np.float32(np.inf)), 3)
    high = maximum_filter(np.where(usable, depth, np.float32(0)), 3)
    footprint = depth / np.float32(camera.intrinsics[0, 0])
    return np.asarray(np.maximum(high - depth, depth - low) > _MAX_TANGENT * footprint + _EDGE_NOISE * noise)


def _enlarged(camera: Camera, inverse: NDArray[np.float32], weight: NDArray[np.float32], factor: int) -> DepthMap:
    """Bilinear between usable depths; without depth where one of the four neighbours has none."""
    values = torch.from_numpy(np.stack([inverse, weight, (inverse > 0).astype(np.float32)]))[None]
    if factor > 1:
        values = interpolate(values, scale_factor=factor, mode="bilinear", align_corners=False)
    larger, weights, known = values[0]
    usable = known > 1 - 1e-4
    intrinsics = np.diag([factor, factor, 1.0]) @ camera.intrinsics
    fine = Camera(intrinsics, camera.world_to_camera, camera.width * factor, camera.height * factor)
    zero = torch.zeros_like(larger)
    return DepthMap(fine, torch.where(usable, larger, zero), torch.where(usable, weights, zero))
