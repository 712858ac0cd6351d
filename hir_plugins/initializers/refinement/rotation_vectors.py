"""Rotations as vectors: the axis times the angle in radians."""

from __future__ import annotations

import cv2
import numpy as np

from hir_core.capture import Array


def rotation_of_vector(vector: Array) -> Array:
    """3×3 rotation (Rodrigues)."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[0])


def vector_of_rotation(rotation: Array) -> Array:
    """Axis times angle (3,)."""
    return np.asarray(cv2.Rodrigues(np.asarray(rotation, dtype=np.float64))[0], dtype=np.float64).reshape(3)
