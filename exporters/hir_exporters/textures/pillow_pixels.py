"""Pixels of an image that Pillow has decoded, as grey or colour with or without alpha, whatever its mode is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.Image import Image


def image_codes(image: Image) -> NDArray[Any]:
    """Pixels (H, W, C): 8-bit codes, of 16-bit grey and floats float32 in [0, 1]; C is 1 grey, 2 grey+alpha, 3 or 4.

    Palettes and CMYK become RGB, or RGBA where they have alpha; two-level images become grey. Raises `ValueError` for
    NaN and infinite pixels.
    """
    if image.mode in ("P", "PA"):
        image = image.convert("RGBA" if "transparency" in image.info or image.mode == "PA" else "RGB")
    pixels: NDArray[Any]
    if image.mode == "F" or image.mode.startswith("I"):
        pixels = np.asarray(image)
        if image.mode != "F":
            pixels = np.clip(pixels, 0, 65535) / np.float32(65535)
        pixels = pixels.astype(np.float32)
        if not np.isfinite(pixels).all():
            raise ValueError("NaN or infinite pixels")
        return pixels[..., None]
    if image.mode not in ("L", "LA", "RGB", "RGBA"):
        image = image.convert({"1": "L", "La": "LA", "RGBa": "RGBA"}.get(image.mode, "RGB"))
    pixels = np.asarray(image)
    return pixels[..., None] if pixels.ndim == 2 else pixels
