"""Textures and constants side by side: resizing, matching sizes, taking samples, encoding to 8 bits."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import linear_to_srgb

Array = NDArray[np.floating]
_Number = TypeVar("_Number", bound=np.generic)


def resize(texture: Array, height: int, width: int) -> Array:
    """(H, W) or (H, W, C) at another size: area average where it shrinks, linear interpolation where it grows."""
    from PIL import Image

    if texture.shape[:2] == (height, width):
        return texture
    tall, wide = texture.shape[0] // height, texture.shape[1] // width
    if tall * height == texture.shape[0] and wide * width == texture.shape[1] and tall * wide > 0:
        rows = texture.reshape(height, tall, texture.shape[1], -1).sum(axis=1)
        blocks = rows.reshape(height, width, wide, -1).sum(axis=2) / texture.dtype.type(tall * wide)
        return blocks.reshape(height, width, *texture.shape[2:])
    smaller = height < texture.shape[0] or width < texture.shape[1]
    method = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
    planes = texture[..., None] if texture.ndim == 2 else texture
    resized = [
        np.asarray(Image.fromarray(np.ascontiguousarray(planes[..., k])).resize((width, height), method))
        for k in range(planes.shape[2])
    ]
    return np.stack(resized, axis=-1).reshape(height, width, *texture.shape[2:])


def limit_size(texture: Array, largest: int) -> Array:
    """The texture with neither side above `largest`, its proportions kept."""
    height, width = texture.shape[:2]
    scale = largest / max(height, width)
    if scale >= 1:
        return texture
    return resize(texture, max(1, round(height * scale)), max(1, round(width * scale)))


def common_size(*values: Array, channels: tuple[int, ...]) -> tuple[int, int] | None:
    """Largest height and width among the values that are textures; `channels[i]` is 1 where a colour ends the shape."""
    sizes = [value.shape[:2] for value, c in zip(values, channels, strict=True) if value.ndim - c == 2]
    return (max(h for h, _ in sizes), max(w for _, w in sizes)) if sizes else None


def constant_if_uniform(value: Array, channels: int) -> Array:
    """A texture all of whose texels are equal as one value; others, and constants, as they are."""
    if value.ndim - channels != 2:
        return value
    first = value[0, 0]
    if not (value[::64] == first).all():  # nearly always enough
        return value
    return np.asarray(first) if (value == first).all() else value


_STRIP = 1 << 16
"""Texels of a strip: its values stay near a processor's cache, and textures of any size need little memory."""


def map_in_strips(compute: Callable[..., NDArray[_Number]], *values: tuple[Array, int]) -> NDArray[_Number]:
    """What a function of texels makes of textures of one size and constants, strip by strip and side by side.

    `values` are (texture or constant, number of channel axes); the result has the textures' height and width.
    """
    height, width = next((value.shape[:2] for value, c in values if value.ndim - c == 2), (0, 0))
    if height * width <= _STRIP:
        return compute(*(value for value, _ in values))
    rows = max(1, _STRIP // width)

    def strip(top: int) -> NDArray[_Number]:
        return compute(*(v[top : top + rows] if v.ndim - c == 2 else v for v, c in values))

    first = strip(0)
    result = np.empty((height, *first.shape[1:]), first.dtype)
    result[:rows] = first

    def fill(top: int) -> None:
        result[top : top + rows] = strip(top)

    with ThreadPoolExecutor(max_workers=4) as pool:
        list(pool.map(fill, range(rows, height, rows)))
    return result


def sample_texels(value: Array, color: bool, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nearest texels (T, 3) or (T,) at `places` (T, 2) in [0, 1), x then y; constants repeat."""
    if value.ndim - color != 2:
        return np.broadcast_to(value.astype(np.float64), (len(places), *value.shape)).copy()
    column = (places[:, 0] * value.shape[1]).astype(np.int64)
    row = (places[:, 1] * value.shape[0]).astype(np.int64)
    return value[row, column].astype(np.float64)


def srgb8(linear: Array) -> NDArray[np.uint8]:
    """8-bit sRGB codes of linear values, clipped to [0, 1]: through a table of 65536 steps, at most 0.06 codes off."""
    table = _srgb_codes()
    return _codes(lambda rows: table[unorm(rows, 65535).astype(np.uint16)], linear)


def unorm8(values: Array) -> NDArray[np.uint8]:
    """8-bit codes of values in [0, 1], clipped and rounded."""
    return _codes(lambda rows: unorm(rows, 255).astype(np.uint8), values)


def unorm(values: Array, largest: int) -> Array:
    """Values in [0, 1] as floats in 0..largest + 0.5, ready to be cut off to whole codes."""
    clipped = np.clip(values, 0.0, 1.0)
    clipped *= clipped.dtype.type(largest)
    clipped += clipped.dtype.type(0.5)
    return clipped


def normal_to_unorm8(normal: Array) -> NDArray[np.uint8]:
    """Unit vectors (H, W, 3) as 8-bit codes, 127.5 being 0."""
    half = np.float32(0.5)
    return _codes(lambda rows: unorm(rows * half + half, 255).astype(np.uint8), normal)


def _codes(encode: Callable[[Array], NDArray[np.uint8]], values: Array) -> NDArray[np.uint8]:
    return map_in_strips(encode, (values, max(values.ndim - 2, 0)))


@cache
def _srgb_codes() -> NDArray[np.uint8]:
    return (linear_to_srgb(np.arange(65536) / 65535) * 255 + 0.5).astype(np.uint8)
