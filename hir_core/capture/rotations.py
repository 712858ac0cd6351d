"""Rotation matrices and unit quaternions (w, x, y, z)."""

from __future__ import annotations

import numpy as np

from hir_core.capture.camera import Array


def rotation_from_quaternion(quaternion: Array) -> Array:
    """3×3 rotation of a quaternion (w, x, y, z) of any length but zero."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a 3×3 rotation, its largest component positive (Shepperd 1978)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    # 4 q qᵀ; the row with the largest diagonal element is not near zero, so no digits cancel
    outer = np.array(
        [
            [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
        ]
    )
    row = outer[np.argmax(np.diag(outer))]
    return np.asarray(row / np.linalg.norm(row))
