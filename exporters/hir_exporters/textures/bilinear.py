"""Bilinear interpolation of numpy images and tables: the one implementation, with an explicit border rule."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Border = Literal["clamp", "wrap_columns"]
"""`clamp` repeats the border's texels; `wrap_columns` continues a row at its other end, as in lat-long images."""


def sample_bilinear(
    values: NDArray[np.floating], column: NDArray[np.floating], row: NDArray[np.floating], border: Border = "clamp"
) -> NDArray[np.floating]:
    """Values (..., C) of an image (H, W, C) at fractional positions, broadcast together, of shape (...).

    Position 0 is the centre of the first texel and W - 1 (H - 1) that of the last: texture coordinates u, v in [0, 1]
    are at column u W - 0.5 and row v H - 0.5. Rows are always clamped to the image, columns follow `border`.
    Positions must be finite.
    """
    height, width = values.shape[:2]
    y = np.clip(row, 0, height - 1)
    # The last row is reached with weight 1 from the row above it, so that both neighbours lie in the image.
    y0 = np.minimum(np.floor(y).astype(np.int64), max(height - 2, 0))
    y1 = np.minimum(y0 + 1, height - 1)
    if border == "clamp":
        x = np.clip(column, 0, width - 1)
        x0 = np.minimum(np.floor(x).astype(np.int64), max(width - 2, 0))
        left, right = x0, np.minimum(x0 + 1, width - 1)
    else:
        x = np.asarray(column)
        x0 = np.floor(x).astype(np.int64)
        left, right = x0 % width, (x0 + 1) % width
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    upper = values[y0, left] * (1 - fx) + values[y0, right] * fx
    lower = values[y1, left] * (1 - fx) + values[y1, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)
