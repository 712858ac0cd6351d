"""From the axes of capture files to ours: worlds with z up, cameras that look along -z."""

from __future__ import annotations

from typing import Any

import numpy as np
from hir_exporters.conventions import Z_UP_TO_Y_UP
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_core.errors import CaptureError

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes of NeRF and Blender (y up, looks along -z) to ours (y down, looks along +z)."""
OPENCV_FROM_OPENGL.setflags(write=False)

WORLD_FROM_Z_UP = np.eye(4)
WORLD_FROM_Z_UP[:3, :3] = Z_UP_TO_Y_UP
WORLD_FROM_Z_UP.setflags(write=False)

BLENDER_FROM_LATLONG = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Turns a direction of `hir_exporters.conventions`' lat-long axes into the z-up axes of Blender's environment texture:
its image centre is +X, a quarter from the left is +Y, the top row is +Z."""
BLENDER_FROM_LATLONG.setflags(write=False)


def rigid_transform(matrix: Any, owner: str, tolerance: float = 1e-2) -> Array:
    """A 4×4 rigid transform from nested lists 4×4 or 3×4; a uniform scale of its axes is taken out.

    Axes that are skewed by more than `tolerance`, mirrored or not finite raise `CaptureError`; small errors (a file in
    float32) are mended by the nearest rotation.
    """
    try:
        array: NDArray[np.float64] = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise CaptureError(f"{owner}: the camera's matrix is not one of numbers") from None
    if array.shape not in ((4, 4), (3, 4)):
        raise CaptureError(f"{owner}: the camera's matrix has the shape {array.shape}; 4×4 is needed")
    if not np.isfinite(array).all():
        raise CaptureError(f"{owner}: the camera's matrix holds NaN or infinite values")
    lengths = np.linalg.norm(array[:3, :3], axis=0)
    if not (lengths > 1e-9).all():
        raise CaptureError(f"{owner}: the camera's matrix has an axis without length")
    u, singular, vt = np.linalg.svd(array[:3, :3] / lengths)
    if np.abs(singular - 1).max() > tolerance or lengths.max() > lengths.min() * (1 + tolerance):
        raise CaptureError(f"{owner}: the camera's axes are skewed; it needs a rotation and a place")
    if np.linalg.det(u @ vt) < 0:
        raise CaptureError(f"{owner}: the camera's axes are mirrored (left-handed)")
    result = np.eye(4)
    result[:3, :3] = u @ vt
    result[:3, 3] = array[:3, 3]
    return result


def rigid_inverse(transform: Array) -> Array:
    """Inverse of a 4×4 rigid transform, exact where `inv` would round."""
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    """3×3 intrinsics."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
