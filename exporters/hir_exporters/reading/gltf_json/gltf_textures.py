"""The images that the textures of a glTF document name, as RGB or RGBA pixels (glTF 2.0, sections 3.8.2 and 3.9)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hir_exporters.errors import InputError
from hir_exporters.reading.gltf_json.stored_accessors import Json
from hir_exporters.reading.mesh_references import gltf_content, image_bytes
from hir_exporters.reading.texture_decoding import Pixels, as_rgb, decoded_pixels

_IMAGE_EXTENSIONS: Final = ("EXT_texture_webp", "KHR_texture_basisu")
"""Extensions of a texture that name an image beside the fallback."""


def image_source(texture: Json) -> int | None:
    """The index of the image of a texture. None where it names none, which glTF allows, or only one of another kind."""
    better = [texture.get("extensions", {}).get(name, {}).get("source") for name in _IMAGE_EXTENSIONS]
    return next((source for source in better if source is not None), texture.get("source"))


@dataclass(frozen=True)
class GltfTextures:
    """A document with its binary chunk; images are decoded when their pixels are asked for."""

    path: Path
    document: Json
    binary: bytes

    @classmethod
    def of_file(cls, path: Path) -> GltfTextures:
        """Those of a .glb or .gltf that `check_references` has accepted."""
        return cls(path, *gltf_content(path))

    def texture(self, reference: Json) -> Json:
        """The texture that a material refers to."""
        found: Json = self.document["textures"][reference["index"]]
        return found

    def pixels(self, reference: Json | None) -> Pixels | None:
        """Pixels (H, W, 3 or 4), read-only, of a material's texture; None without a texture or an image of it."""
        source = None if reference is None else image_source(self.texture(reference))
        if source is None:
            return None
        image = self.document["images"][source]
        data = image_bytes(self.path, dict(self.document), image, self.binary)
        if data is None:
            raise InputError(f"{self.path} names {image['uri'][:80]!r}, which is not in its folder; put it beside it")
        return as_rgb(decoded_pixels(data, f"{self.path}: image {source}"))

    def name(self, reference: Json) -> str:
        """What messages call a texture: its file, else the number of its image."""
        source = image_source(self.texture(reference))
        uri = "data:" if source is None else str(self.document["images"][source].get("uri") or "data:")
        return f"image {source}" if uri.startswith("data:") else uri[:80]
