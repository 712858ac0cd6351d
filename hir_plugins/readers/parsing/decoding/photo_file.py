"""One photograph on disk: linear pixels, mask and clipped pixels, read on demand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from hir_exporters.conventions import srgb_to_linear
from numpy.typing import NDArray

from hir_core.capture import Pixels
from hir_core.capture.lens import Lens, undistort
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.decoding.picture_decoding import EncodedPixels, read_encoded

SATURATED_LEVEL = 254 / 255
"""Pixels with an encoded value of at least this, in any channel, are clipped."""


@dataclass(frozen=True)
class PhotoFile:
    """Reads a photograph, and its mask file, when called; picklable, without pixels in memory."""

    path: Path
    mask_path: Path | None = None
    orient: bool = False
    """Apply the EXIF orientation. Cameras from other programs are for images as stored."""
    lens: Lens | None = None
    """A fisheye lens, which `Camera` cannot represent; the result is a pinhole image."""
    width: int = 0
    """Checked against the file unless it is 0."""
    height: int = 0
    alpha: Literal["mask", "ignore"] = "mask"

    def __call__(self) -> Pixels:
        encoded = read_encoded(self.path, self.orient)
        height, width = encoded.shape[:2]
        if self.width and (width, height) != (self.width, self.height):
            raise CaptureError(
                f"{self.path} is {width}×{height}, its camera {self.width}×{self.height}; use the image that the "
                "camera "
                "was read with"
            )
        color, saturated = linear_pixels(encoded)
        mask: NDArray[np.float32] | None = None
        if self.mask_path is not None:
            mask = read_mask(self.mask_path, width, height, self.orient)
        elif encoded.shape[2] in (2, 4) and self.alpha == "mask":
            mask = _to_unit_range(encoded[..., -1])
        pixels = Pixels(color, mask, saturated)
        return pixels if self.lens is None else undistort(pixels, self.lens)


def read_mask(path: Path, width: int, height: int, orient: bool = False) -> NDArray[np.float32]:
    """Coverage (H, W) in 0…1 of a mask file: its alpha channel if that varies, else its brightness."""
    pixels = read_encoded(path, orient)
    if pixels.shape[:2] != (height, width):
        raise CaptureError(
            f"the mask {path} is {pixels.shape[1]}×{pixels.shape[0]}, its image {width}×{height}; give them the same "
            "size"
        )
    if pixels.shape[2] in (2, 4) and pixels[..., -1].min() < pixels[..., -1].max():
        return np.ascontiguousarray(_to_unit_range(pixels[..., -1]))
    colors = pixels[..., : 1 if pixels.shape[2] <= 2 else 3]
    return np.asarray(_to_unit_range(colors).mean(axis=2), dtype=np.float32)


def linear_pixels(encoded: EncodedPixels) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Linear colour (H, W, 3) and clipped pixels (H, W) of encoded pixels (H, W, C)."""
    colors = encoded[..., : 1 if encoded.shape[2] <= 2 else 3]
    if encoded.dtype == np.float32:
        linear = np.maximum(colors, 0.0)
        saturated = np.zeros(colors.shape[:2], dtype=bool)
    else:
        linear = _decoding_table(encoded.dtype.name)[colors]
        saturated = (colors >= np.ceil(SATURATED_LEVEL * np.iinfo(encoded.dtype).max)).any(axis=2)
    if linear.shape[2] == 1:
        linear = np.repeat(linear, 3, axis=2)
    return np.ascontiguousarray(linear, dtype=np.float32), saturated


@lru_cache(maxsize=2)
def _decoding_table(kind: str) -> NDArray[np.float32]:
    """Linear value of each sRGB code; ten times as fast as evaluating the curve for each pixel."""
    codes = np.iinfo(kind).max + 1
    table: NDArray[np.float32] = srgb_to_linear(np.arange(codes) / (codes - 1)).astype(np.float32)
    table.setflags(write=False)
    return table


def _to_unit_range(values: EncodedPixels) -> NDArray[np.float32]:
    if values.dtype == np.float32:
        return np.asarray(np.clip(values, 0, 1), dtype=np.float32)
    return values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)
