"""Conversions from the axes of capture files: worlds with +Z up, cameras that look along -z."""

from __future__ import annotations

import numpy as np
from hir_exporters.conventions import Z_UP_TO_Y_UP
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_core.errors import CaptureError

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From the camera axes of NeRF and Blender (y up, looks along -z) to OpenCV's (y down, looks along +z)."""
OPENCV_FROM_OPENGL.setflags(write=False)

MAX_DISTANCE = 1e9
"""Largest coordinate of a camera, in the units of the file: positions from satellites, in metres, are below 1e8."""

WORLD_FROM_Z_UP = np.eye(4)
WORLD_FROM_Z_UP[:3, :3] = Z_UP_TO_Y_UP
WORLD_FROM_Z_UP.setflags(write=False)

BLENDER_FROM_LATLONG = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotates a direction from `hir_exporters.conventions`' lat-long axes to the z-up axes of Blender's environment
texture: the image's centre is +X, a quarter from the left is +Y, the top row is +Z."""
BLENDER_FROM_LATLONG.setflags(write=False)


def rigid_transform(matrix: object, owner: str, tolerance: float = 1e-2) -> Array:
    """A 4×4 rigid transform from nested lists 4×4 or 3×4; a uniform scale of its axes is removed.

    Axes that are skewed by more than `tolerance`, mirrored or not finite raise `CaptureError`. Smaller errors, as in a
    float32 file, are corrected by the nearest rotation.
    """
    try:
        array: NDArray[np.float64] = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise CaptureError(f"{owner}: the camera's matrix is not numeric; write 4×4 numbers") from None
    if array.shape not in ((4, 4), (3, 4)):
        raise CaptureError(f"{owner}: the camera's matrix has the shape {array.shape}; write 4×4 numbers")
    if not np.isfinite(array).all():
        raise CaptureError(f"{owner}: the camera's matrix contains NaN or infinite values; export the cameras again")
    lengths = np.linalg.norm(array[:3, :3], axis=0)
    if not (lengths > 1e-9).all():
        raise CaptureError(f"{owner}: the camera's matrix has an axis of zero length; export the cameras again")
    u, singular, vt = np.linalg.svd(array[:3, :3] / lengths)
    if np.abs(singular - 1).max() > tolerance or lengths.max() > lengths.min() * (1 + tolerance):
        raise CaptureError(f"{owner}: the camera's axes are skewed; write a rotation and a position")
    if np.linalg.det(u @ vt) < 0:
        raise CaptureError(f"{owner}: the camera's axes are mirrored (left-handed); negate one axis")
    if array.shape == (4, 4) and np.abs(array[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise CaptureError(f"{owner}: the last row of the camera's matrix is not 0 0 0 1; export the cameras again")
    result = np.eye(4)
    result[:3, :3] = u @ vt
    result[:3, 3] = array[:3, 3]
    return result


def rigid_inverse(transform: Array) -> Array:
    """Inverse of a 4×4 rigid transform, by transposition instead of a numerical inverse."""
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    """3×3 intrinsics."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
