"""Axes, colour, UV and environment conventions shared by every layer (docs/conventions.md).

World: right-handed, +Y up. Images are linear in memory; 8-bit files are sRGB. The UV origin is top-left (glTF).
Environments are lat-long images as in OpenEXR, USD and Mitsuba: the centre is +Z, a quarter of the width is +X.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Z_UP_TO_Y_UP: Final[NDArray[np.float64]] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation (3, 3) from a z-up world to ours: (x, y, z) -> (x, z, -y). Its transpose goes back."""
Z_UP_TO_Y_UP.setflags(write=False)

LUMINANCE_WEIGHTS: Final[NDArray[np.float64]] = np.array([0.2126, 0.7152, 0.0722])
"""Rec. 709 luminance of linear RGB."""
LUMINANCE_WEIGHTS.setflags(write=False)

SRGB_POWER: Final = 2.4
"""Of the curve of sRGB above its linear segment (IEC 61966-2-1)."""

ALPHA_MIN: Final = 1e-4
"""Smallest GGX width that a material may have; below it, float32 cannot distinguish the lobe from a mirror."""


def srgb_to_linear(encoded: ArrayLike) -> NDArray[np.floating]:
    """IEC 61966-2-1 decoding, element by element; the linear segment is extended below zero, so that there is no NaN.

    float32 stays float32, all other types become float64.
    """
    x = _floating(encoded)
    curved = ((np.maximum(x, 0.0) + 0.055) / 1.055) ** SRGB_POWER
    return np.where(x <= 0.04045, x / 12.92, curved).astype(x.dtype, copy=False)


def linear_to_srgb(linear: ArrayLike) -> NDArray[np.floating]:
    """Inverse of `srgb_to_linear`; values above 1 follow the curve, values below 0 the linear segment."""
    x = _floating(linear)
    curved = 1.055 * np.maximum(x, 0.0) ** (1.0 / SRGB_POWER) - 0.055
    return np.where(x <= 0.0031308, x * 12.92, curved).astype(x.dtype, copy=False)


def luminance(linear_rgb: ArrayLike) -> NDArray[np.floating]:
    """Rec. 709 luminance (...) of linear RGB (..., 3)."""
    rgb = _floating(linear_rgb)
    return rgb @ LUMINANCE_WEIGHTS.astype(rgb.dtype)


def flip_v(uvs: ArrayLike) -> NDArray[np.floating]:
    """UVs (..., 2) converted between the origins top-left (glTF, assets) and bottom-left (USD, OBJ, PLY)."""
    uvs = _floating(uvs)
    flipped = uvs.copy()
    flipped[..., 1] = 1 - uvs[..., 1]
    return flipped


def direction_to_latlong_uv(directions: ArrayLike) -> NDArray[np.floating]:
    """Lat-long coordinates (..., 2) of directions (..., 3) of any length; u in [0, 1), v in [0, 1] from the top row.

    `u = 0.5 - atan2(x, z) / 2 pi`, `v = acos(y / |d|) / pi`. The poles and the zero vector get u = 0.5.
    """
    d = _floating(directions)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    # Next to the seam the quotient differs from 1/2 by at least one unit in the last place: % never rounds up to 1.
    u = (0.5 - np.arctan2(x, z) / (2 * np.pi)) % 1.0
    # atan2 keeps full precision at the poles, where acos loses half of the digits.
    v = np.arctan2(np.hypot(x, z), y) / np.pi
    return np.stack([u, v], axis=-1).astype(d.dtype, copy=False)


def latlong_uv_to_direction(u: ArrayLike, v: ArrayLike) -> NDArray[np.floating]:
    """Unit directions (..., 3) of lat-long coordinates; u wraps, v = 0 is +Y, (0.5, 0.5) is +Z, (0.25, 0.5) is +X."""
    u, v = np.broadcast_arrays(_floating(u), _floating(v))
    azimuth = (0.5 - u) * (2 * np.pi)
    polar = v * np.pi
    sin_polar = np.sin(polar)
    direction = np.stack([sin_polar * np.sin(azimuth), np.cos(polar), sin_polar * np.cos(azimuth)], axis=-1)
    return direction.astype(u.dtype, copy=False)


def latlong_directions(height: int, width: int) -> NDArray[np.float64]:
    """Unit directions (height, width, 3) through the pixel centres of a lat-long image."""
    u = (np.arange(width) + 0.5) / width
    v = (np.arange(height) + 0.5) / height
    return latlong_uv_to_direction(u[None, :], v[:, None]).astype(np.float64, copy=False)


def latlong_solid_angles(height: int, width: int) -> NDArray[np.float64]:
    """Exact solid angle in steradians (height, 1) of one pixel of each row; times width they sum to 4 pi."""
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    return ((edges[:-1] - edges[1:]) * (2 * np.pi / width))[:, None]


def _floating(values: ArrayLike) -> NDArray[np.floating]:
    array = np.asarray(values)
    return array if array.dtype == np.float32 else array.astype(np.float64, copy=False)
