"""Packs a surface's parameters into factors and 8-bit images, in the channel layout that glTF and USD share."""

from __future__ import annotations

import hashlib
import io
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Lock
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMaterial, textures
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.textures.image_files import encode_png
from hir_exporters.textures.texture_maps import limit_size, normal_to_unorm8, resize, srgb8, unorm8

Image8 = NDArray[np.uint8]


@dataclass(frozen=True)
class PackedSurface:
    """Linear factors that multiply images (H, W, C); an image is None where the parameter is constant."""

    base_color: tuple[float, float, float]
    base_color_image: Image8 | None
    """sRGB."""
    metallic: float
    roughness: float
    orm_image: Image8 | None
    """Red 255 (no occlusion), green roughness, blue metalness; linear."""
    specular_weight: float
    specular_color: tuple[float, float, float]
    specular_weight_image: Image8 | None
    """RGBA; alpha is the weight, linear. The same array as the colour's where both use one image."""
    specular_color_image: Image8 | None
    """sRGB, with the weight in alpha where both use one image."""
    ior: float
    normal_image: Image8 | None
    """Tangent space, green up; linear."""


@dataclass(frozen=True)
class EncodedImage:
    """The bytes of an image file and its file name."""

    name: str
    data: bytes
    mime: Literal["image/png", "image/jpeg"]


def limit_texture_sizes(material: AssetMaterial, largest: int) -> AssetMaterial:
    """The material with textures reduced to at most `largest` pixels a side; normals are normalised again."""

    def reduced(value: NDArray[np.float32], ends: int) -> NDArray[np.float32]:
        return value if value.ndim - ends != 2 else limit_size(value, largest).astype(np.float32, copy=False)

    normal = material.normal
    if normal is not None and max(normal.shape[:2]) > largest:
        normal = limit_size(normal, largest)
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), np.array([0, 0, 1], np.float32))
    if material.metalness is not None:
        # Products of averages are not averages of products: the parameters are reduced, not the albedos.
        return AssetMaterial.metallic(
            reduced(material.base_color, 1),
            reduced(material.metalness, 0),
            reduced(material.roughness, 0),
            normal,
            material.observed,
            material.dielectric_f0,
        )
    return replace(
        material,
        diffuse_albedo=reduced(material.diffuse_albedo, 1),
        specular_albedo=reduced(material.specular_albedo, 1),
        roughness=reduced(material.roughness, 0),
        normal=normal,
    )


def texture_size_warnings(material: AssetMaterial, largest: int) -> tuple[str, ...]:
    """A warning where `limited` will reduce a texture of the material."""
    found = max((max(value.shape[:2]) for _, value in textures(material)), default=0)
    if found <= largest:
        return ()
    return (f"textures were reduced from {found} to {largest} pixels; max_texture_size sets the limit",)


def pack_surface(surface: MetallicSurface, normal: NDArray[np.float32] | None) -> PackedSurface:
    """Images of the parameters that vary; constant parameters become factors."""
    base, base_image = _color(surface.base_color, normalise=False)
    metallic, roughness, orm = _orm(surface.metallic, surface.roughness)
    weight, weight_plane = _scalar(surface.specular_weight)
    color, color_image = _color(surface.specular_color, normalise=True)
    weight_image: Image8 | None = None
    if weight_plane is not None and color_image is not None:
        size = weight_plane.shape if weight_plane.size >= color_image[..., 0].size else color_image.shape[:2]
        plane, rgb = (np.asarray(resize_codes(x, size[0], size[1])) for x in (weight_plane, color_image))
        weight_image = color_image = np.concatenate([rgb, plane[..., None]], axis=-1)
    elif weight_plane is not None:
        white = np.full((*weight_plane.shape, 3), 255, np.uint8)
        weight_image = np.concatenate([white, weight_plane[..., None]], axis=-1)
    return PackedSurface(
        base,
        base_image,
        metallic,
        roughness,
        orm,
        weight,
        color,
        weight_image,
        color_image,
        surface.ior,
        None if normal is None else normal_to_unorm8(normal),
    )


def resize_codes(codes: Image8, height: int, width: int) -> Image8:
    """8-bit codes at another size."""
    if codes.shape[:2] == (height, width):
        return codes
    return np.rint(resize(codes.astype(np.float32), height, width)).astype(np.uint8)


def pack_color(value: NDArray[np.floating]) -> tuple[tuple[float, float, float], Image8 | None]:
    """Factor and sRGB image of a colour in [0, 1]."""
    return _color(value, normalise=False)


def encode_images(
    images: Sequence[tuple[str, Image8]], image_format: Literal["png", "jpeg"] = "png", quality: int = 92
) -> list[EncodedImage]:
    """Files of named images, encoded in four threads; JPEG only for colour without alpha, never for normal maps."""

    def encode(item: tuple[str, Image8]) -> EncodedImage:
        name, pixels = item
        if image_format == "jpeg" and pixels.shape[2] == 3 and "normal" not in name:
            return EncodedImage(f"{name}.jpg", _encode_jpeg(pixels, quality), "image/jpeg")
        return EncodedImage(f"{name}.png", _PNG_CACHE.png(pixels), "image/png")

    with ThreadPoolExecutor(max_workers=4) as pool:
        return list(pool.map(encode, images))


class PngCache:
    """Encodes PNG and caches the last few files: formats exported one after the other mostly share their images."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._files: OrderedDict[tuple[bytes, tuple[int, ...]], bytes] = OrderedDict()
        self._lock = Lock()

    def png(self, pixels: Image8) -> bytes:
        """The file of 8-bit pixels (H, W, C); the key is their SHA-256."""
        key = hashlib.sha256(np.ascontiguousarray(pixels).data).digest(), pixels.shape
        with self._lock:
            cached = self._files.get(key)
        data = encode_png(pixels) if cached is None else cached
        with self._lock:
            self._files[key] = data
            self._files.move_to_end(key)
            while len(self._files) > self._capacity:
                self._files.popitem(last=False)
        return data


_PNG_CACHE = PngCache(8)


def _encode_jpeg(pixels: Image8, quality: int) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="JPEG", quality=quality, subsampling=0, optimize=False)
    return stream.getvalue()


def _color(value: NDArray[np.floating], normalise: bool) -> tuple[tuple[float, float, float], Image8 | None]:
    if value.ndim == 1:
        return (float(value[0]), float(value[1]), float(value[2])), None
    # Dividing by the largest value uses all 8 bits, also for small reflectances.
    largest = float(value.max()) if normalise and value.max() > 0 else 1.0
    return (largest, largest, largest), srgb8(value / np.float32(largest) if largest != 1.0 else value)


def _scalar(value: NDArray[np.floating]) -> tuple[float, Image8 | None]:
    if value.ndim == 0:
        return float(value), None
    largest = float(value.max()) or 1.0
    return largest, unorm8(value / np.float32(largest))


def _orm(metallic: NDArray[np.floating], roughness: NDArray[np.floating]) -> tuple[float, float, Image8 | None]:
    if metallic.ndim == 0 and roughness.ndim == 0:
        return float(metallic), float(roughness), None
    textures = [value for value in (metallic, roughness) if value.ndim == 2]
    height, width = max(value.shape for value in textures)
    image = np.full((height, width, 3), 255, np.uint8)
    if roughness.ndim == 2:
        image[..., 1] = unorm8(resize(roughness, height, width))
    if metallic.ndim == 2:
        image[..., 2] = unorm8(resize(metallic, height, width))
    elif float(metallic) == 0:
        image[..., 2] = 0  # readers that ignore the factor see no metal either
    return float(metallic) if metallic.ndim == 0 else 1.0, float(roughness) if roughness.ndim == 0 else 1.0, image
