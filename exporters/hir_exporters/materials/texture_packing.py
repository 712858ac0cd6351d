"""Packs a surface's parameters into factors and 8-bit images, in the channel layout that glTF and USD share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMaterial, textures
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.textures.image_encoding import resize_codes
from hir_exporters.textures.texture_maps import limit_size, normal_to_unorm8, resize, srgb8, unorm8

Image8 = NDArray[np.uint8]

FLAT_NORMAL_CODES: Final = normal_to_unorm8(np.array([[[0, 0, 1]]], np.float32))[0, 0]
"""The codes of a normal map that changes nothing."""


@dataclass(frozen=True)
class PackedSurface:
    """Linear factors that multiply images (H, W, C); an image is None where all its 8-bit codes would be equal."""

    base_color: tuple[float, float, float]
    base_color_image: Image8 | None
    """sRGB."""
    metallic: float
    roughness: float
    orm_image: Image8 | None
    """Red 255 (no occlusion), green roughness, blue metalness; linear."""
    metallic_textured: bool
    roughness_textured: bool
    specular_weight: float
    specular_color: tuple[float, float, float]
    specular_weight_image: Image8 | None
    """RGBA; alpha is the weight, linear. The same array as the colour's where both use one image."""
    specular_color_image: Image8 | None
    """sRGB, with the weight in alpha where both use one image."""
    ior: float
    normal_image: Image8 | None
    """Tangent space, green up; linear."""


def limit_texture_sizes(material: AssetMaterial, largest: int) -> AssetMaterial:
    """The material with textures reduced to at most `largest` pixels a side; normals are normalised again."""
    if _largest_side(material) <= largest:
        return material

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


def _largest_side(material: AssetMaterial) -> int:
    return max((max(value.shape[:2]) for _, value in textures(material)), default=0)


def texture_size_warnings(material: AssetMaterial, largest: int) -> tuple[str, ...]:
    """A warning where `limited` will reduce a texture of the material."""
    found = _largest_side(material)
    if found <= largest:
        return ()
    return (f"textures were reduced from {found} to {largest} pixels; max_texture_size sets the limit",)


def pack_surface(surface: MetallicSurface, normal: NDArray[np.float32] | None) -> PackedSurface:
    """Images of the parameters that vary; constant parameters become factors."""
    base, base_image = _color(surface.base_color, normalise=False)
    metallic, roughness = (_without_uniform_codes(value) for value in (surface.metallic, surface.roughness))
    orm = _orm(metallic, roughness)
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
        float(metallic) if metallic.ndim == 0 else 1.0,
        float(roughness) if roughness.ndim == 0 else 1.0,
        orm,
        metallic.ndim == 2,
        roughness.ndim == 2,
        weight,
        color,
        weight_image,
        color_image,
        surface.ior,
        pack_normal(normal),
    )


def pack_normal(normal: NDArray[np.float32] | None) -> Image8 | None:
    """The normal map's codes; None where it is flat."""
    return normal_to_unorm8(normal) if normal is not None and not is_flat(normal) else None


def is_flat(normal: NDArray[np.float32]) -> bool:
    """Whether the codes of a normal map equal the mesh's own normals everywhere."""
    return all((normal_to_unorm8(part) == FLAT_NORMAL_CODES).all() for part in (normal[::64], normal))


def pack_color(value: NDArray[np.floating]) -> tuple[tuple[float, float, float], Image8 | None]:
    """Factor and sRGB image of a colour in [0, 1]."""
    return _color(value, normalise=False)


def _color(value: NDArray[np.floating], normalise: bool) -> tuple[tuple[float, float, float], Image8 | None]:
    if value.ndim == 1:
        return (float(value[0]), float(value[1]), float(value[2])), None
    # Dividing by the largest value uses all 8 bits, also for small reflectances.
    largest = float(value.max()) if normalise and value.max() > 0 else 1.0
    codes = srgb8(value, largest)
    if _is_uniform(codes):
        red, green, blue = srgb_to_linear(codes[0, 0] / np.float32(255)) * largest
        return (float(red), float(green), float(blue)), None
    return (largest, largest, largest), codes


def _scalar(value: NDArray[np.floating]) -> tuple[float, Image8 | None]:
    if value.ndim == 0:
        return float(value), None
    largest = float(value.max()) or 1.0
    codes = unorm8(value, largest)
    if _is_uniform(codes):
        return float(codes[0, 0]) / 255 * largest, None
    return largest, codes


def _is_uniform(codes: Image8) -> bool:
    first = codes[0, 0]
    return bool((codes[::64] == first).all() and (codes == first).all())  # the first test decides most images


def _orm(metallic: NDArray[np.floating], roughness: NDArray[np.floating]) -> Image8 | None:
    if metallic.ndim == 0 and roughness.ndim == 0:
        return None
    textures = [value for value in (metallic, roughness) if value.ndim == 2]
    height, width = max(value.shape for value in textures)
    image = np.full((height, width, 3), 255, np.uint8)
    if roughness.ndim == 2:
        image[..., 1] = unorm8(resize(roughness, height, width))
    if metallic.ndim == 2:
        image[..., 2] = unorm8(resize(metallic, height, width))
    elif float(metallic) == 0:
        image[..., 2] = 0  # readers that ignore the factor see no metal either
    return image


def _without_uniform_codes(value: NDArray[np.floating]) -> NDArray[np.floating]:
    """A constant in place of a texture whose 8-bit codes are all equal."""
    if value.ndim == 0:
        return value
    codes = unorm8(value)
    return np.asarray(codes[0, 0] / np.float32(255)) if _is_uniform(codes) else value
