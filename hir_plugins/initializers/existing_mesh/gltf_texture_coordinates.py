"""glTF primitives with texture coordinates but without a material, for a loader that drops these coordinates."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

from hir_exporters.files.untrusted_json import parse_json
from hir_exporters.reading.mesh_references import check_references

_JSON_CHUNK = 0x4E4F534A


def with_materials(path: Path) -> tuple[io.BytesIO, str] | None:
    """The content of a .glb or .gltf whose primitives all have a material, and its format; None where they have one.

    trimesh keeps TEXCOORD_0 only beside a material. Raises `InputError` for a file that is refused.
    """
    if path.suffix.lower() not in (".glb", ".gltf"):
        return None
    check_references(path)
    data = path.read_bytes()
    is_binary = data.startswith(b"glTF")
    end = 20 + struct.unpack_from("<I", data, 12)[0] if is_binary else len(data)
    document = parse_json(data[20:end] if is_binary else data)
    if not isinstance(document, dict) or not _add_material(document):
        return None
    text = json.dumps(document).encode()
    if not is_binary:
        return io.BytesIO(text), "gltf"
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON_CHUNK) + text + data[end:]
    return io.BytesIO(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks), "glb"


def _add_material(document: dict[str, Any]) -> bool:
    """Adds one material for all primitives that lack one beside texture coordinates. Whether there are such."""
    bare = [
        primitive
        for mesh in document.get("meshes", [])
        for primitive in mesh.get("primitives", [])
        if "TEXCOORD_0" in primitive.get("attributes", {}) and "material" not in primitive
    ]
    if bare:
        materials = document.setdefault("materials", [])
        for primitive in bare:
            primitive["material"] = len(materials)
        materials.append({"pbrMetallicRoughness": {}})
    return bool(bare)
