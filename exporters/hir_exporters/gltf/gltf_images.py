"""Adds images, a sampler and textures to a glTF document."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import quote

from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.materials.texture_packing import EncodedImage

if TYPE_CHECKING:
    from pygltflib import GLTF2

_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP_TO_EDGE, _REPEAT = 9729, 9987, 33071, 10497


def add_textures(
    document: GLTF2, images: list[EncodedImage], writer: BinaryWriter | None, prefix: str, atlas: bool
) -> dict[str, int]:
    """Adds the images and returns the index of each texture by the image's name without suffix.

    With a writer, images go into the buffer; without one they are referenced as files with this prefix. `atlas`: all
    UVs are in [0, 1], so that the sampler clamps instead of repeating.
    """
    from pygltflib import Image, Sampler, Texture

    if not images:
        return {}
    wrap = _CLAMP_TO_EDGE if atlas else _REPEAT
    document.samplers.append(Sampler(magFilter=_LINEAR, minFilter=_LINEAR_MIPMAP_LINEAR, wrapS=wrap, wrapT=wrap))
    textures = {}
    for image in images:
        name = image.name.rpartition(".")[0]
        if writer is None:
            document.images.append(Image(name=name, uri=quote(prefix + image.name)))
        else:
            document.images.append(Image(name=name, mimeType=image.mime, bufferView=writer.view(image.data)))
        document.textures.append(Texture(sampler=0, source=len(document.images) - 1, name=name))
        textures[name] = len(document.textures) - 1
    return textures
