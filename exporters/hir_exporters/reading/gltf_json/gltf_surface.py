"""The parameters of a glTF material: metallic-roughness with KHR_materials_specular and _ior, specular-glossiness."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.reading.gltf_json.gltf_textures import GltfTextures
from hir_exporters.reading.gltf_json.stored_accessors import Json
from hir_exporters.reading.readback import index_of_refraction
from hir_exporters.reading.texture_decoding import Pixels, times, times_color, unit_vectors

SurfaceOfFile = tuple[MetallicSurface, SpecularSurface | None, NDArray[np.float32] | None]
"""Surface, specular workflow, decoded normal map (H, W, 3)."""

SPECULAR_GLOSSINESS: Final = "KHR_materials_pbrSpecularGlossiness"
UNLIT: Final = "KHR_materials_unlit"

_WHITE: Final = [1.0, 1.0, 1.0]
_RED, _GREEN, _BLUE, _ALPHA = range(4)


def gltf_surface(material: Json, textures: GltfTextures) -> SurfaceOfFile:
    """The parameters of a material, with the defaults of glTF 2.0 and of the extensions.

    The base colour of an unlit material is read as that of a rough dielectric: its metalness, 1 by default, has no
    meaning. Raises `InputError` where an image is missing or broken.
    """
    core, extensions = material.get("pbrMetallicRoughness") or {}, material.get("extensions") or {}
    specular = extensions.get("KHR_materials_specular", {})
    unlit = UNLIT in extensions
    packed = None if unlit else textures.pixels(core.get("metallicRoughnessTexture"))
    weight = _channel(textures.pixels(specular.get("specularTexture")), _ALPHA)
    surface = MetallicSurface(
        base_color=_color(core.get("baseColorFactor"), textures.pixels(core.get("baseColorTexture"))),
        metallic=times(0.0 if unlit else core.get("metallicFactor", 1.0), _channel(packed, _BLUE)),
        roughness=times(1.0 if unlit else core.get("roughnessFactor", 1.0), _channel(packed, _GREEN)),
        specular_weight=times(specular.get("specularFactor", 1.0), weight),
        specular_color=_color(
            specular.get("specularColorFactor"), textures.pixels(specular.get("specularColorTexture"))
        ),
        ior=index_of_refraction(extensions.get("KHR_materials_ior", {}).get("ior", 1.5), textures.path),
        residual=0.0,
    )
    old = extensions.get(SPECULAR_GLOSSINESS)
    specular_surface = None if old is None or unlit else _specular_glossiness(old, textures)
    return surface, specular_surface, _normal_map(material.get("normalTexture"), textures)


def texture_references(material: Json) -> Iterator[Json]:
    """The references to textures that `gltf_surface` reads."""
    core, extensions = material.get("pbrMetallicRoughness") or {}, material.get("extensions") or {}
    specular, old = extensions.get("KHR_materials_specular", {}), extensions.get(SPECULAR_GLOSSINESS, {})
    found = [core.get("baseColorTexture"), core.get("metallicRoughnessTexture"), material.get("normalTexture")]
    found += [specular.get("specularTexture"), specular.get("specularColorTexture")]
    found += [old.get("diffuseTexture"), old.get("specularGlossinessTexture")]
    yield from (reference for reference in found if reference is not None)


def _specular_glossiness(old: Json, textures: GltfTextures) -> SpecularSurface:
    image = textures.pixels(old.get("specularGlossinessTexture"))
    return SpecularSurface(
        _color(old.get("diffuseFactor"), textures.pixels(old.get("diffuseTexture"))),
        _color(old.get("specularFactor"), image),
        1 - times(old.get("glossinessFactor", 1.0), _channel(image, _ALPHA)),
        residual=0.0,
    )


def _normal_map(reference: Json | None, textures: GltfTextures) -> NDArray[np.float32] | None:
    """The vectors as they are stored; with another `scale` than 1, of unit length (glTF 2.0, normalTexture.scale)."""
    pixels = textures.pixels(reference)
    if pixels is None or reference is None:
        return None
    vectors, scale = unit_vectors(pixels), np.float32(reference.get("scale", 1.0))
    if scale != 1:
        vectors[..., :2] *= scale
        vectors /= np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), np.float32(1e-6))
    return vectors


def _color(factor: Any, pixels: Pixels | None) -> NDArray[np.floating]:
    return times_color(_WHITE if factor is None else factor[:3], pixels)


def _channel(pixels: Pixels | None, index: int) -> Pixels | None:
    """(H, W) of one channel; None, which stands for 1, for the alpha of an image without alpha."""
    return None if pixels is None or index >= pixels.shape[2] else pixels[..., index]
