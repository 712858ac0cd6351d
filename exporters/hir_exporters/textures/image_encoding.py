"""Encodes 8-bit textures as PNG, JPEG, WebP or KTX2, losslessly or within a number of bytes."""

from __future__ import annotations

import hashlib
import io
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Lock
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import ExportError
from hir_exporters.textures.image_files import encode_png
from hir_exporters.textures.ktx2 import Kind, block_size, encode_ktx2
from hir_exporters.textures.texture_maps import resize

Image8 = NDArray[np.uint8]

COLOR_TEXTURES: Final = ("base_color", "specular", "specular_color", "diffuse", "specular_glossiness")
"""Names of textures that are sRGB; all others are linear, and WebP, which halves the resolution of colour, would blur
their channels."""

FALLBACK_SIZE: Final = 512
"""Largest side in pixels of textures for readers without an extension that the file uses."""

MIN_NORMAL_QUALITY: Final = 90
"""Lowest JPEG quality of a normal map within a budget: blocks of lower quality are visible in reflections."""

_QUALITIES: Final = (92, 85, 75)
_LOSSLESS_WEBP_EFFORT: Final = 20  # of 100; at 92, a map of 2048 pixels takes more than ten seconds
_SMALLEST_SIDE: Final = 128


@dataclass(frozen=True)
class EncodedImage:
    """The bytes of an image file and its file name."""

    name: str
    data: bytes
    mime: Literal["image/png", "image/jpeg", "image/webp", "image/ktx2"]
    fallback: EncodedImage | None = None
    """A small JPEG or PNG for readers without WebP or KTX2."""


@dataclass(frozen=True)
class ImageEncoding:
    """How the images of one file are encoded."""

    image_format: Literal["png", "jpeg", "webp", "ktx2"] = "png"
    quality: int = 92
    """Of JPEG, WebP and ETC1S in KTX2, 1 to 100."""
    size: int = 1 << 16
    """Larger images are reduced to this many pixels a side."""
    lossy_linear: bool = False
    """Whether normal maps and other linear textures may be JPEG, too. In KTX2, other linear textures may be ETC1S."""

    def sentence(self) -> str:
        """For the report of an export."""
        lossy = f"{self.image_format.upper()} of quality {self.quality}"
        return f"images are {'PNG' if self.image_format == 'png' else lossy}, at most {self.size} pixels a side"


def encode_images(images: Mapping[str, Image8], encoding: ImageEncoding | None = None) -> dict[str, EncodedImage]:
    """Files of named images (H, W, C), encoded in four threads; PNG without an encoding.

    Alpha channels stay PNG in `jpeg`; linear textures stay lossless unless `lossy_linear`.
    """
    how = encoding or ImageEncoding()

    def encode(item: tuple[str, Image8]) -> EncodedImage:
        return _encoded(item[0], reduced(item[1], how.size), how)

    with ThreadPoolExecutor(max_workers=4) as pool:
        return dict(zip(images, pool.map(encode, images.items()), strict=True))


def encode_within(
    images: Mapping[str, Image8], limit: int, encoding: ImageEncoding
) -> tuple[dict[str, EncodedImage], ImageEncoding]:
    """The files with at most `limit` bytes in all, and the most accurate encoding that achieves it.

    `encoding` is tried first, then lower qualities, then half the size, down to 128 pixels. Raises `ExportError` where
    even that is larger.
    """
    for candidate in _smaller_encodings(encoding, max((max(i.shape[:2]) for i in images.values()), default=1)):
        files = encode_images(images, candidate)
        if sum(_weight(file) for file in files.values()) <= limit:
            return files, candidate
    raise ExportError(
        f"images of {_SMALLEST_SIDE} pixels a side are larger than the {max(limit, 0)} bytes left for them"
    )


def _smaller_encodings(encoding: ImageEncoding, size: int) -> Iterator[ImageEncoding]:
    size = min(size, encoding.size)
    yield replace(encoding, size=size)
    lossy = replace(encoding, image_format="jpeg" if encoding.image_format == "png" else encoding.image_format)
    while size >= _SMALLEST_SIDE:
        for quality in _QUALITIES:
            if quality <= encoding.quality:
                yield replace(lossy, quality=quality, size=size, lossy_linear=True)
        size //= 2


def _weight(file: EncodedImage) -> int:
    return len(file.data) + (len(file.fallback.data) if file.fallback else 0)


def _encoded(name: str, pixels: Image8, how: ImageEncoding) -> EncodedImage:
    linear, alpha = name not in COLOR_TEXTURES, pixels.shape[2] in (2, 4)
    if how.image_format == "webp" and not (linear and how.lossy_linear):
        effort = _LOSSLESS_WEBP_EFFORT if linear else how.quality
        data = _pillow_bytes(pixels, "WEBP", quality=effort, lossless=linear, method=1 if linear else 4)
        return EncodedImage(f"{name}.webp", data, "image/webp", _fallback(name, pixels, how.quality))
    if how.image_format == "ktx2":
        return _ktx2(name, pixels, how)
    if how.image_format != "png" and not alpha and (how.lossy_linear or not _is_normal_map(name)):
        return _jpeg(name, pixels, max(how.quality, MIN_NORMAL_QUALITY) if _is_normal_map(name) else how.quality)
    return _png(name, pixels)


def _fallback(name: str, pixels: Image8, quality: int) -> EncodedImage:
    """A small image that every reader of glTF opens."""
    small, lossless = reduced(pixels, FALLBACK_SIZE), name not in COLOR_TEXTURES or pixels.shape[2] in (2, 4)
    return _png(f"{name}_fallback", small) if lossless else _jpeg(f"{name}_fallback", small, quality)


def _ktx2(name: str, pixels: Image8, how: ImageEncoding) -> EncodedImage:
    """Colour as ETC1S, linear maps as UASTC, whose channels are independent; normal maps are never ETC1S."""
    kind: Kind = "normal" if _is_normal_map(name) else "color" if name in COLOR_TEXTURES else "linear"
    lossy = kind == "color" or (how.lossy_linear and kind == "linear")
    whole_blocks = resize_codes(pixels, *block_size((pixels.shape[0], pixels.shape[1])))
    data = _CACHE.file(whole_blocks, encode_ktx2, kind, how.quality if lossy else 0)
    return EncodedImage(f"{name}.ktx2", data, "image/ktx2", _fallback(name, pixels, how.quality))


def _is_normal_map(name: str) -> bool:
    return "normal" in name


def _jpeg(name: str, pixels: Image8, quality: int) -> EncodedImage:
    data = _pillow_bytes(pixels, "JPEG", quality=min(quality, 95), subsampling=0, optimize=False)
    return EncodedImage(f"{name}.jpg", data, "image/jpeg")


def _png(name: str, pixels: Image8) -> EncodedImage:
    return EncodedImage(f"{name}.png", _CACHE.file(pixels, encode_png), "image/png")


def reduced(pixels: Image8, size: int) -> Image8:
    """8-bit codes with at most `size` pixels a side."""
    height, width = pixels.shape[:2]
    scale = size / max(height, width)
    if scale >= 1:
        return pixels
    return resize_codes(pixels, max(1, round(height * scale)), max(1, round(width * scale)))


def resize_codes(codes: Image8, height: int, width: int) -> Image8:
    """8-bit codes at another size."""
    if codes.shape[:2] == (height, width):
        return codes
    return np.rint(resize(codes.astype(np.float32), height, width)).astype(np.uint8)


def _pillow_bytes(pixels: Image8, kind: str, **options: object) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(stream, format=kind, **options)
    return stream.getvalue()


class FileCache:
    """Caches the last few encoded files: formats exported one after the other mostly share their images."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._files: OrderedDict[tuple[object, ...], bytes] = OrderedDict()
        self._lock = Lock()

    def file(self, pixels: Image8, encode: Callable[..., bytes], *options: object) -> bytes:
        """`encode(pixels, *options)` of 8-bit pixels (H, W, C); the key is their SHA-256 with function and options."""
        digest = hashlib.sha256(np.ascontiguousarray(pixels).data).digest()
        key = (digest, pixels.shape, encode, *options)
        with self._lock:
            cached = self._files.get(key)
        data = encode(pixels, *options) if cached is None else cached
        with self._lock:
            self._files[key] = data
            self._files.move_to_end(key)
            while len(self._files) > self._capacity:
                self._files.popitem(last=False)
        return data


_CACHE = FileCache(8)
