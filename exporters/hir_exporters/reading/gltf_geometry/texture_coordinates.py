"""What trimesh needs to keep a glTF's texture coordinates: a material beside them, and an attribute of their own."""

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


def with_texture_coordinates(data: bytes, stored: bool = False) -> bytes:
    """The same .gltf or .glb, in which primitives with texture coordinates and no material name the default one.

    Those of `stored` floats are an attribute `STORED_UVS`, too.
    """
    text, chunks = split_document(data)
    document: dict[str, Any] = parse_json(text)
    primitives = [primitive for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
    mapped = [primitive for primitive in primitives if "TEXCOORD_0" in primitive["attributes"]]
    bare = [primitive for primitive in mapped if "material" not in primitive]
    if not bare and not (stored and mapped):
        return data
    if bare:
        materials = document.setdefault("materials", [])
        for primitive in bare:
            primitive["material"] = len(materials)
        materials.append({})
    for primitive in mapped if stored else ():
        accessor = primitive["attributes"]["TEXCOORD_0"]
        if document["accessors"][accessor].get("componentType") == _FLOAT:
            primitive["attributes"][STORED_UVS] = accessor
    text = json.dumps(document).encode()
    if not data.startswith(_MAGIC):
        return text
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + _JSON_CHUNK + text + chunks
    return _MAGIC + struct.pack("<II", 2, 12 + len(chunks)) + chunks
