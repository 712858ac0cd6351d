"""EXT_lights_image_based: the light inside the file, for Babylon.js. Other engines use the .hdr beside the file.

Each level has six faces, rows from the bottom, as RGBD in PNG: sRGB codes of radiance times alpha, with an alpha that
scales the brightest channel to 1. Levels are linear in perceptual roughness. The coefficients are those of irradiance,
not of irradiance / pi.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import linear_to_srgb
from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.light.environment_map import irradiance_harmonics
from hir_exporters.light.prefilter import level_sizes, linear_roughness, prefiltered_cubemap
from hir_exporters.textures.image_encoding import EncodedImage
from hir_exporters.textures.image_files import encode_png

if TYPE_CHECKING:
    from pygltflib import GLTF2

NAME = "EXT_lights_image_based"
CUBEMAP_SIZE = 128
"""Side of the first level in pixels; the images have at most 0.4 MB."""

_CONDON_SHORTLEY_PHASE = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1.0])[:, None]
"""(-1)^m: part of the basis in the extension's reference and in Babylon.js."""

MAX_RADIANCE = 255.0
"""The largest radiance of RGBD, at alpha 1/255. Brighter texels are clipped; the harmonics are not."""


def light_images(radiance: NDArray[np.floating]) -> tuple[list[EncodedImage], dict[str, object]]:
    """Images of the faces, level by level, and the light's JSON object without its `specularImages`."""
    # The cubemap is defined in a left-handed world: z is mirrored.
    mirrored = np.roll(np.asarray(radiance, np.float64)[:, ::-1], radiance.shape[1] // 2, axis=1)
    levels = len(level_sizes(CUBEMAP_SIZE))
    cubemap = prefiltered_cubemap(mirrored, [linear_roughness(k, levels) for k in range(levels)], CUBEMAP_SIZE)
    images = [
        EncodedImage(f"light_{k}_{face}.png", encode_png(rgbd(pixels[::-1])), "image/png")
        for k, level in enumerate(cubemap)
        for face, pixels in enumerate(level)
    ]
    light = {
        "name": "environment",
        # Always 1, because Babylon.js multiplies the harmonics by it twice.
        "intensity": 1.0,
        "irradianceCoefficients": (irradiance_harmonics(mirrored) * _CONDON_SHORTLEY_PHASE).tolist(),
        "specularImageSize": CUBEMAP_SIZE,
    }
    return images, light


def rgbd(radiance: NDArray[np.floating]) -> NDArray[np.uint8]:
    """RGBD codes (H, W, 4) of radiance (H, W, 3); readers decode srgb_to_linear(rgb) / alpha."""
    largest = np.maximum(radiance.max(axis=-1, keepdims=True), 1.0)
    alpha = np.clip(np.floor(255 / largest), 1, 255)
    color = np.clip(radiance * (alpha / 255), 0, 1)
    return np.rint(np.concatenate([linear_to_srgb(color) * 255, alpha], axis=-1)).astype(np.uint8)


def add_light(
    document: GLTF2, images: list[EncodedImage], light: dict[str, object], writer: BinaryWriter | None, prefix: str
) -> None:
    """Adds the images and the extension to the document and its scene."""
    from pygltflib import Image

    first = len(document.images)
    for image in images:
        if writer is None:
            document.images.append(Image(name=image.name, uri=quote(prefix + image.name)))
        else:
            document.images.append(Image(name=image.name, mimeType=image.mime, bufferView=writer.view(image.data)))
    faces = [list(range(first + 6 * k, first + 6 * k + 6)) for k in range(len(images) // 6)]
    document.extensions = {**(document.extensions or {}), NAME: {"lights": [{**light, "specularImages": faces}]}}
    document.scenes[0].extensions = {NAME: {"light": 0}}
    document.extensionsUsed.append(NAME)
