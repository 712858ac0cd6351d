"""Textures and constants: resizing, common sizes, nearest-texel samples, and 8-bit codes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import linear_to_srgb

Array = NDArray[np.floating]
_Number = TypeVar("_Number", bound=np.generic)


def resize(texture: Array, height: int, width: int) -> Array:
    """(H, W) or (H, W, C) at another size: area average where a side shrinks, else bilinear interpolation."""
    from PIL import Image

    if texture.shape[:2] == (height, width):
        return texture
    tall, wide = texture.shape[0] // height, texture.shape[1] // width
    if tall * height == texture.shape[0] and wide * width == texture.shape[1] and tall * wide > 0:
        return _block_means(texture.reshape(*texture.shape[:2], -1), tall, wide).reshape(
            height, width, *texture.shape[2:]
        )
    smaller = height < texture.shape[0] or width < texture.shape[1]
    method = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
    planes = texture[..., None] if texture.ndim == 2 else texture
    resized = [
        np.asarray(Image.fromarray(np.ascontiguousarray(planes[..., k])).resize((width, height), method))
        for k in range(planes.shape[2])
    ]
    return np.stack(resized, axis=-1).reshape(height, width, *texture.shape[2:])


def _block_means(texture: Array, tall: int, wide: int) -> Array:
    """Means of blocks of `tall` x `wide` texels of a texture (H, W, C), without large temporary arrays."""
    height, width, channels = texture.shape[0] // tall, texture.shape[1] // wide, texture.shape[2]
    means = np.empty((height, width, channels), texture.dtype)
    step = max(1, _TEXELS_PER_STRIP // texture.shape[1])
    for top in range(0, height, step):
        rows = texture[top * tall : (top + step) * tall].reshape(-1, tall, texture.shape[1], channels)
        summed = _sum_of([rows[:, k] for k in range(tall)]).reshape(-1, width, wide, channels)
        means[top : top + step] = _sum_of([summed[:, :, k] for k in range(wide)])
    means /= texture.dtype.type(tall * wide)
    return means


def _sum_of(parts: Sequence[Array]) -> Array:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def limit_size(texture: Array, largest: int) -> Array:
    """The texture reduced so that neither side exceeds `largest`; its aspect ratio is kept."""
    height, width = texture.shape[:2]
    scale = largest / max(height, width)
    if scale >= 1:
        return texture
    return resize(texture, max(1, round(height * scale)), max(1, round(width * scale)))


def common_size(*values: Array, channels: tuple[int, ...]) -> tuple[int, int] | None:
    """Largest height and width of the values that are textures, else None; `channels[i]` is 1 for colours, else 0."""
    sizes = [value.shape[:2] for value, c in zip(values, channels, strict=True) if value.ndim - c == 2]
    return (max(h for h, _ in sizes), max(w for _, w in sizes)) if sizes else None


def constant_if_uniform(value: Array, channels: int) -> Array:
    """One value for a texture whose texels are all equal; other textures and constants are returned unchanged."""
    if value.ndim - channels != 2:
        return value
    first = value[0, 0]
    if not (value[::64] == first).all():  # decides most textures without reading all texels
        return value
    return np.asarray(first) if (value == first).all() else value


_TEXELS_PER_STRIP = 1 << 16
"""Temporary arrays of a strip fit into a processor's cache and bound the memory for textures of any size."""


def map_in_strips(compute: Callable[..., NDArray[_Number]], *values: tuple[Array, int]) -> NDArray[_Number]:
    """Applies a per-texel function to textures of one size and constants, strip by strip in four threads.

    `values` are pairs (texture or constant, number of channel axes). The result has the textures' height and width.
    """
    height, width = next((value.shape[:2] for value, c in values if value.ndim - c == 2), (0, 0))
    if height * width <= _TEXELS_PER_STRIP:
        return compute(*(value for value, _ in values))
    rows = max(1, _TEXELS_PER_STRIP // width)

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


def sample_texels(value: Array, color: bool, uvs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nearest texels (T, 3) of a colour or (T,) of a scalar at `uvs` (T, 2) in [0, 1); constants are repeated."""
    if value.ndim - color != 2:
        return np.broadcast_to(value.astype(np.float64), (len(uvs), *value.shape)).copy()
    column = (uvs[:, 0] * value.shape[1]).astype(np.int64)
    row = (uvs[:, 1] * value.shape[0]).astype(np.int64)
    return value[row, column].astype(np.float64)


def srgb8(linear: Array, largest: float = 1.0) -> NDArray[np.uint8]:
    """8-bit sRGB codes of linear values divided by `largest` and clipped to [0, 1].

    A table of 65536 steps is at most 0.06 codes off.
    """
    table = _srgb_codes()
    return _codes(lambda rows: table[unorm(_divided(rows, largest), 65535).astype(np.uint16)], linear)


def unorm8(values: Array, largest: float = 1.0) -> NDArray[np.uint8]:
    """8-bit codes of values divided by `largest`, clipped to [0, 1] and rounded."""
    return _codes(lambda rows: unorm(_divided(rows, largest), 255).astype(np.uint8), values)


def _divided(values: Array, largest: float) -> Array:
    return values if largest == 1.0 else values / np.float32(largest)


def unorm(values: Array, largest: int) -> Array:
    """Values clipped to [0, 1], times `largest`, plus 0.5: truncation gives the nearest integer codes."""
    clipped = np.clip(values, 0.0, 1.0)
    clipped *= clipped.dtype.type(largest)
    clipped += clipped.dtype.type(0.5)
    return clipped


def normal_to_unorm8(normal: Array) -> NDArray[np.uint8]:
    """Unit vectors (H, W, 3) as 8-bit codes; 0 is at 127.5."""
    half = np.float32(0.5)
    return _codes(lambda rows: unorm(rows * half + half, 255).astype(np.uint8), normal)


def _codes(encode: Callable[[Array], NDArray[np.uint8]], values: Array) -> NDArray[np.uint8]:
    return map_in_strips(encode, (values, max(values.ndim - 2, 0)))


@cache
def _srgb_codes() -> NDArray[np.uint8]:
    return (linear_to_srgb(np.arange(65536) / 65535) * 255 + 0.5).astype(np.uint8)
