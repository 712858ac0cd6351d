"""KHR_materials_pbrSpecularGlossiness: archived by Khronos, but the only one for specular colour that Unity's glTFast
reads.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hir_exporters.materials.surfaces import SpecularSurface
from hir_exporters.materials.texture_packing import pack_color
from hir_exporters.textures.image_encoding import resize_codes
from hir_exporters.textures.texture_maps import unorm8

NAME = "KHR_materials_pbrSpecularGlossiness"


def specular_glossiness_images(surface: SpecularSurface) -> dict[str, NDArray[np.uint8]]:
    """Images by texture name: diffuse (sRGB), and specular (sRGB) with glossiness 1 - sqrt(alpha) in alpha."""
    images = {}
    _, diffuse = pack_color(surface.diffuse)
    if diffuse is not None:
        images["diffuse"] = diffuse
    _, specular = pack_color(surface.specular)
    if specular is None and surface.roughness.ndim == 0:
        return images
    glossiness = np.atleast_2d(unorm8(1 - surface.roughness))
    if specular is None:
        specular = np.full((1, 1, 3), 255, np.uint8)
    height = max(specular.shape[0], glossiness.shape[0])
    width = max(specular.shape[1], glossiness.shape[1])
    planes = [resize_codes(specular, height, width), resize_codes(glossiness, height, width)[..., None]]
    images["specular_glossiness"] = np.concatenate(planes, axis=-1)
    return images


def specular_glossiness_extension(surface: SpecularSurface, textures: Mapping[str, int]) -> dict[str, object]:
    """The extension's JSON object: factors for constant parameters, textures for the others."""
    diffuse, specular = pack_color(surface.diffuse)[0], pack_color(surface.specular)[0]
    textured = "specular_glossiness" in textures
    value: dict[str, object] = {
        "diffuseFactor": [*diffuse, 1.0],
        "specularFactor": list(specular),
        "glossinessFactor": 1.0 if textured else 1.0 - float(surface.roughness),
    }
    if "diffuse" in textures:
        value["diffuseTexture"] = {"index": textures["diffuse"]}
    if textured:
        value["specularGlossinessTexture"] = {"index": textures["specular_glossiness"]}
    return value
