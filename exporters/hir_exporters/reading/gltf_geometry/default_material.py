"""glTF's default material, written out: trimesh keeps texture coordinates only beside a material that is there."""

from __future__ import annotations

import json
import struct
from typing import Any, Final

from hir_exporters.files.untrusted_json import parse_json

_MAGIC: Final = b"glTF"
_JSON_CHUNK: Final = b"JSON"
_HEADER_BYTES: Final = 20
"""Of a .glb and its first chunk."""


def split_document(data: bytes) -> tuple[bytes, bytes]:
    """The JSON text of a .gltf or .glb, and the chunks that follow it in a .glb."""
    if not data.startswith(_MAGIC):
        return data, b""
    (length,) = struct.unpack_from("<I", data, 12)
    return data[_HEADER_BYTES : _HEADER_BYTES + length], data[_HEADER_BYTES + length :]


def with_default_material(data: bytes) -> bytes:
    """The same .gltf or .glb, in which primitives with texture coordinates and no material name the default one."""
    text, chunks = split_document(data)
    document: dict[str, Any] = parse_json(text)
    bare = [
        primitive
        for mesh in document.get("meshes", [])
        for primitive in mesh["primitives"]
        if "TEXCOORD_0" in primitive["attributes"] and "material" not in primitive
    ]
    if not bare:
        return data
    materials = document.setdefault("materials", [])
    for primitive in bare:
        primitive["material"] = len(materials)
    materials.append({})
    text = json.dumps(document).encode()
    if not data.startswith(_MAGIC):
        return text
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + _JSON_CHUNK + text + chunks
    return _MAGIC + struct.pack("<II", 2, 12 + len(chunks)) + chunks
