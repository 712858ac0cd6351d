"""Decodes the textures of exported files, and multiplies them by the factors of their material.

Pillow decodes them, Basis Universal KTX2.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.conventions import srgb_to_linear
from hir_exporters.textures.ktx2 import IDENTIFIER, decode_ktx2
from hir_exporters.textures.pillow_images import open_image

Pixels = NDArray[Any]
"""(H, W, C) codes of 8 bits, or float32 in [0, 1]."""

_UNIT: Final = np.arange(256, dtype=np.float32) / np.float32(255)
"""Value of each 8-bit code."""


def decoded_pixels(data: bytes) -> Pixels:
    """Pixels (H, W, C), read-only: 8-bit codes unchanged, 16-bit codes as floats in [0, 1].

    The last few images are kept: files of several formats mostly contain the same ones.
    """
    return _decoded(_Content(data))


class _Content:
    """Bytes that are compared by their SHA-256, so that the cache keeps pixels only."""

    def __init__(self, data: bytes) -> None:
        self.data: bytes | None = data
        self._digest = hashlib.sha256(data).digest()

    def __hash__(self) -> int:
        return hash(self._digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Content) and self._digest == other._digest


@lru_cache(maxsize=6)
def _decoded(content: _Content) -> Pixels:
    assert content.data is not None
    if content.data.startswith(IDENTIFIER):
        pixels: Pixels = decode_ktx2(content.data)
    else:
        with open_image(content.data) as image:
            pixels = np.asarray(image)
    content.data = None
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    pixels = pixels if pixels.dtype == np.uint8 else pixels.astype(np.float32) / np.float32(65535)
    pixels.setflags(write=False)
    return pixels


def unit_values(pixels: Pixels) -> NDArray[np.float32]:
    """Values in [0, 1], without a transfer function."""
    values = pixels.astype(np.float32)
    if pixels.dtype == np.uint8:
        values /= np.float32(255)
    return values


def linear_color(pixels: Pixels) -> NDArray[np.floating]:
    """Linear colour (H, W, 3) of sRGB pixels."""
    return srgb_to_linear(pixels[..., :3]) if pixels.dtype != np.uint8 else srgb_to_linear(_UNIT)[pixels[..., :3]]


def unit_vectors(pixels: Pixels) -> NDArray[np.float32]:
    """Components -1 to 1 of the vectors (H, W, 3) of a normal map, as they are stored."""
    vectors = unit_values(pixels[..., :3])
    vectors *= np.float32(2)
    vectors -= np.float32(1)
    return vectors


def times_color(factor: ArrayLike, pixels: Pixels | None) -> NDArray[np.floating]:
    """A linear factor times an sRGB texture, if there is one."""
    constant = np.asarray(factor, np.float32)
    return constant if pixels is None else _scaled(linear_color(pixels), constant)


def times(factor: ArrayLike, texture: Pixels | None) -> NDArray[np.floating]:
    """A factor times a linear texture, if there is one."""
    constant = np.asarray(factor, np.float32)
    return constant if texture is None else _scaled(unit_values(texture), constant)


def _scaled(values: NDArray[np.floating], factor: NDArray[np.float32]) -> NDArray[np.floating]:
    """`values`, a new array, multiplied in place; a factor of 1 takes no time."""
    if (factor != 1).any():
        values *= factor
    return values
