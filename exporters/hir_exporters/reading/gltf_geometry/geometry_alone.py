"""A glTF as trimesh gets it: without pictures, and with what it needs to keep the texture coordinates."""

from __future__ import annotations

import json
import struct
from typing import Any, Final

from hir_exporters.files.untrusted_json import parse_json

_MAGIC: Final = b"glTF"
_JSON_CHUNK: Final = b"JSON"
_HEADER_BYTES: Final = 20
"""Of a .glb and its first chunk."""
_FLOAT: Final = 5126

STORED_UVS: Final = "_HIR_TEXCOORD_0"
"""Attribute of a vertex with the texture coordinates as they are stored: trimesh turns its own over, which rounds."""


def split_document(data: bytes) -> tuple[bytes, bytes]:
    """The JSON text of a .gltf or .glb, and the chunks that follow it in a .glb."""
    if not data.startswith(_MAGIC):
        return data, b""
    (length,) = struct.unpack_from("<I", data, 12)
    return data[_HEADER_BYTES : _HEADER_BYTES + length], data[_HEADER_BYTES + length :]


def geometry_alone(data: bytes, stored_uvs: bool = False) -> bytes:
    """The same .gltf or .glb with empty materials and no pictures, which trimesh would find and decode in ways of its
    own. Primitives with texture coordinates have a material, because trimesh keeps them only beside one.

    With `stored_uvs`, texture coordinates that are floats are an attribute `STORED_UVS`, too.
    """
    text, chunks = split_document(data)
    document: dict[str, Any] = parse_json(text)
    primitives = [primitive for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
    mapped = [primitive for primitive in primitives if "TEXCOORD_0" in primitive["attributes"]]
    for name in ("materials", "textures", "images", "samplers"):
        document.pop(name, None)
    document["materials"] = [{}]
    for primitive in primitives:
        if "material" in primitive or "TEXCOORD_0" in primitive["attributes"]:
            primitive["material"] = 0
    for primitive in mapped if stored_uvs else ():
        accessor = primitive["attributes"]["TEXCOORD_0"]
        if document["accessors"][accessor].get("componentType") == _FLOAT:
            primitive["attributes"][STORED_UVS] = accessor
    text = json.dumps(document).encode()
    if not data.startswith(_MAGIC):
        return text
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + _JSON_CHUNK + text + chunks
    return _MAGIC + struct.pack("<II", 2, 12 + len(chunks)) + chunks
