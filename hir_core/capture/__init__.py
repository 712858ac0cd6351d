"""Cameras, photographs and captures; numpy only."""

from hir_core.capture.camera import Array, Camera, similarity_scale
from hir_core.capture.capture import Capture, EnvironmentSource, OrientedPoints, View
from hir_core.capture.coordinate_frames import CoordinateFrames
from hir_core.capture.measured_depth import DepthPixels, MeasuredDepth
from hir_core.capture.pixels import Pixels, block_mean

__all__ = [
    "Array",
    "Camera",
    "Capture",
    "CoordinateFrames",
    "DepthPixels",
    "EnvironmentSource",
    "MeasuredDepth",
    "OrientedPoints",
    "Pixels",
    "View",
    "block_mean",
    "similarity_scale",
]
