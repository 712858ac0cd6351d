"""Adds images, a sampler and textures to a glTF document."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.textures.image_encoding import EncodedImage

if TYPE_CHECKING:
    from pygltflib import GLTF2

EXTENSIONS: Final = MappingProxyType({"image/webp": "EXT_texture_webp", "image/ktx2": "KHR_texture_basisu"})
"""The extension of a texture whose image has this type."""

_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP_TO_EDGE, _REPEAT = 9729, 9987, 33071, 10497


def add_textures(
    document: GLTF2, images: Mapping[str, EncodedImage], writer: BinaryWriter | None, prefix: str, atlas: bool
) -> dict[str, int]:
    """Adds the images and returns the index of each texture by the image's key.

    With a writer, images go into the buffer; without one they are referenced as files with this prefix. `atlas`: all
    UVs are in [0, 1], so that the sampler clamps instead of repeating. WebP and KTX2 are written as their extension
    beside the fallback.
    """
    from pygltflib import Sampler, Texture

    if not images:
        return {}
    if not document.samplers:
        wrap = _CLAMP_TO_EDGE if atlas else _REPEAT
        document.samplers.append(Sampler(magFilter=_LINEAR, minFilter=_LINEAR_MIPMAP_LINEAR, wrapS=wrap, wrapT=wrap))
    textures = {}
    for key, image in images.items():
        texture = Texture(sampler=0, source=_add_image(document, image.fallback or image, writer, prefix), name=key)
        if image.fallback is not None:
            texture.extensions = {EXTENSIONS[image.mime]: {"source": _add_image(document, image, writer, prefix)}}
            if EXTENSIONS[image.mime] not in document.extensionsUsed:
                document.extensionsUsed.append(EXTENSIONS[image.mime])
        document.textures.append(texture)
        textures[key] = len(document.textures) - 1
    return textures


def _add_image(document: GLTF2, image: EncodedImage, writer: BinaryWriter | None, prefix: str) -> int:
    from pygltflib import Image

    name = image.name.rpartition(".")[0]
    if writer is None:
        document.images.append(Image(name=name, uri=quote(prefix + image.name)))
    else:
        document.images.append(Image(name=name, mimeType=image.mime, bufferView=writer.view(image.data)))
    return len(document.images) - 1
