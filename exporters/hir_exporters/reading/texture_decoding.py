"""Decodes the textures of exported files, and multiplies them by the factors of their material.

Pillow decodes them, Basis Universal KTX2.
"""

from __future__ import annotations

import hashlib
import warnings
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import HirError, InputError
from hir_exporters.textures.ktx2 import IDENTIFIER, decode_ktx2
from hir_exporters.textures.pillow_images import open_image
from hir_exporters.textures.pillow_pixels import image_codes

Pixels = NDArray[Any]
"""(H, W, C) codes of 8 bits, or float32 in [0, 1]."""

_UNIT: Final = np.arange(256, dtype=np.float32) / np.float32(255)
"""Value of each 8-bit code."""


def decoded_pixels(data: bytes, name: str = "an image") -> Pixels:
    """Pixels (H, W, C), read-only: 8-bit codes unchanged, 16-bit codes as floats in [0, 1].

    C is 1 grey, 2 grey+alpha, 3 or 4; palettes are resolved. The last few images are cached: files of several formats
    mostly contain the same ones. Raises `InputError` with `name` for a broken image.
    """
    return _decoded(_Content(data, name))


def as_rgb(pixels: Pixels) -> Pixels:
    """The same pixels with three or four channels, read-only: grey repeated as red, green and blue."""
    channels = pixels.shape[2]
    if channels == 1:
        return np.broadcast_to(pixels, (*pixels.shape[:2], 3))
    return pixels[..., [0, 0, 0, 1]] if channels == 2 else pixels


class _Content:
    """Bytes that are compared by their SHA-256, so that the cache keeps pixels only."""

    def __init__(self, data: bytes, name: str) -> None:
        self.data: bytes | None = data
        self.name = name
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
        pixels = _pillow_pixels(content.data, content.name)
    content.data = None
    pixels.setflags(write=False)
    return pixels


def _pillow_pixels(data: bytes, name: str) -> Pixels:
    try:
        with open_image(data, name=name) as image, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata that is not used
            return image_codes(image)
    except HirError:
        raise
    except Exception as error:  # Pillow's decoders raise many types on broken data
        raise InputError(f"{name} is a broken image ({error}); write it again") from error


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
