"""Depth maps of a sensor, weighted by confidence, without their edges, at the resolution of the voxels."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import interpolate

from hir_core.capture import Camera, View
from hir_core.capture.depth_samples import usable_depths
from hir_plugins.initializers.stereo.depth_consistency import DepthMap

MAX_ENLARGEMENT = 8


def sensor_map(view: View, noise: float) -> DepthMap | None:
    """The usable depths of a view in world units, enlarged bilinearly to about the photograph's resolution.

    Weights are confidences: also an oblique surface proves that the space before it is empty. None where the view has
    no depth.
    """
    measured = view.measured_depth()
    if measured is None or view.camera is None:
        return None
    camera, pixels = measured
    usable = usable_depths(camera, pixels, noise)
    weight = np.where(usable, pixels.confidence, 0).astype(np.float32)
    inverse = np.where(usable, 1 / np.maximum(pixels.depth, np.float32(1e-30)), 0).astype(np.float32)
    return _enlarged(camera, inverse, weight, min(MAX_ENLARGEMENT, math.ceil(view.camera.width / camera.width)))


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
