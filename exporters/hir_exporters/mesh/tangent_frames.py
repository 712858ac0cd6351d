"""Orthonormal frames around directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def tangent_frames(normals: Array) -> Array:
    """(N, 3, 3) of unit normals (N, 3): the columns are two tangents and the normal. The choice is fixed."""
    up = np.where(np.abs(normals[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    tangent = np.cross(up, normals)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    return np.stack([tangent, np.cross(normals, tangent), normals], axis=-1)
