"""Decodes the textures of exported files with Pillow, and multiplies them by the factors of their material."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.conventions import srgb_to_linear
from hir_exporters.textures.pillow_images import open_image

Pixels = NDArray[Any]
"""(H, W, C) codes of 8 bits, or float32 in [0, 1]."""


def decoded_pixels(data: bytes) -> Pixels:
    """Pixels (H, W, C): 8-bit codes unchanged, 16-bit codes as floats in [0, 1]."""
    with open_image(data) as image:
        pixels = np.asarray(image)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    return pixels if pixels.dtype == np.uint8 else pixels.astype(np.float32) / np.float32(65535)


def unit_values(pixels: Pixels) -> NDArray[np.float32]:
    """Values in [0, 1], without a transfer function."""
    return pixels.astype(np.float32) / np.float32(255) if pixels.dtype == np.uint8 else pixels.astype(np.float32)


def linear_color(pixels: Pixels) -> NDArray[np.floating]:
    """Linear colour (H, W, 3) of sRGB pixels."""
    if pixels.dtype != np.uint8:
        return srgb_to_linear(pixels[..., :3])
    return srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255))[pixels[..., :3]]


def times_color(factor: ArrayLike, pixels: Pixels | None) -> NDArray[np.floating]:
    """A linear factor times an sRGB texture, if there is one."""
    return times(factor, None if pixels is None else linear_color(pixels))


def times(factor: ArrayLike, texture: Pixels | None) -> NDArray[np.floating]:
    """A factor times a linear texture, if there is one."""
    constant = np.asarray(factor, np.float32)
    return constant if texture is None else unit_values(texture) * constant
