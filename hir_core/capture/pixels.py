"""A decoded photograph: linear colour, mask and clipped pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.errors import CaptureError


@dataclass(frozen=True)
class Pixels:
    """Linear colour (not premultiplied by the mask), the object's coverage, and saturated pixels."""

    color_linear: NDArray[np.float32]
    """H W 3, scene-linear, not multiplied by the mask."""
    mask: NDArray[np.float32] | None
    """H W coverage of the object in 0…1; None where it is unknown."""
    saturated: NDArray[np.bool_]
    """H W, where the sensor clipped: the true radiance may be higher."""

    def downsampled(self, factor: int) -> Pixels:
        """Averages blocks of factor×factor pixels; colour is weighted by the mask, so backgrounds do not bleed in."""
        if factor == 1:
            return self
        mask = None if self.mask is None else block_mean(self.mask, factor)
        if self.mask is None or mask is None:
            color = block_mean(self.color_linear, factor)
        else:
            weighted = block_mean(self.color_linear * self.mask[..., None], factor)
            plain = block_mean(self.color_linear, factor)
            color = np.where(mask[..., None] > 1e-6, weighted / np.maximum(mask[..., None], 1e-6), plain)
        saturated = block_mean(self.saturated.astype(np.float32), factor) > 0
        return Pixels(color.astype(np.float32), mask, saturated)


def block_mean(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """An image (H, W, …) at 1/`factor`, each pixel the mean of a block; a border that fills no block is cut."""
    height, width = image.shape[0] // factor, image.shape[1] // factor
    if height == 0 or width == 0:
        raise CaptureError(f"an image of {image.shape[1]}×{image.shape[0]} cannot be downsampled by {factor}")
    total = np.zeros((height, width, *image.shape[2:]), np.float32)
    for row in range(factor):  # numpy's mean over two axes takes 4 to 6 times as long, at factors 4 and 2
        for column in range(factor):
            total += image[row : height * factor : factor, column : width * factor : factor]
    total /= factor**2
    return total
