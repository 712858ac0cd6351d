"""Rewrites a glTF file without EXT_meshopt_compression and KHR_mesh_quantization, which trimesh does not read."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import ExportError, InputError

if TYPE_CHECKING:
    from pygltflib import GLTF2

DRACO: Final = "KHR_draco_mesh_compression"
MESHOPT: Final = "EXT_meshopt_compression"
DECODED_EXTENSIONS: Final = frozenset({MESHOPT, "KHR_mesh_quantization"})
"""Extensions that `decompressed_glb` removes."""

_COMPONENT_TYPES: Final = {5120: ("<i1", 127), 5121: ("<u1", 255), 5122: ("<i2", 32767), 5123: ("<u2", 65535)}
"""numpy type and largest value, by glTF's componentType."""

_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def decompressed_glb(document: GLTF2, buffer: Callable[[int], bytes]) -> bytes:
    """A .glb of the document without `DECODED_EXTENSIONS`; `buffer` returns the content of a buffer by its index.

    Images beside the file are still referenced. Raises `InputError` for a buffer view with two different sizes,
    `ExportError` where the library meshopt is missing.
    """
    plain = json.loads(document.gltf_to_json())
    parts = [view_content(view, buffer) for view in plain["bufferViews"]]
    for accessor in plain["accessors"]:
        if accessor.get("normalized"):
            view = plain["bufferViews"][accessor["bufferView"]]
            parts.append(_floats(accessor, parts[accessor["bufferView"]], view.get("byteStride", 0)).tobytes())
            plain["bufferViews"].append({"byteLength": len(parts[-1])})
            accessor |= {"bufferView": len(parts) - 1, "byteOffset": 0, "componentType": 5126, "normalized": False}
            accessor.pop("min", None), accessor.pop("max", None)
    padded = [part + bytes(-len(part) % 4) for part in parts]
    start = 0
    for view, part in zip(plain["bufferViews"], padded, strict=True):
        view.pop("extensions", None)
        view |= {"buffer": 0, "byteOffset": start}
        start += len(part)
    plain["buffers"] = [{"byteLength": start}]
    for key in ("extensionsUsed", "extensionsRequired"):
        plain[key] = [name for name in plain.get(key, []) if name not in DECODED_EXTENSIONS]
    text = json.dumps({key: value for key, value in plain.items() if value != []}).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + start)
    return b"".join(
        [head, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", start, b"BIN\0"), *padded]
    )


def view_content(view: Mapping[str, Any], buffer: Callable[[int], bytes]) -> bytes:
    """The bytes of a buffer view without its compression. Raises as `decompressed_glb`."""
    compression = (view.get("extensions") or {}).get(MESHOPT)
    location = compression or view
    start = location.get("byteOffset", 0)
    stored = buffer(location["buffer"])[start : start + location["byteLength"]]
    if compression is None:
        return stored
    if compression["count"] * compression["byteStride"] != view["byteLength"]:
        raise InputError(f"a buffer view of {view['byteLength']} bytes has a compressed content of another size")
    try:
        import meshopt
    except ImportError:
        raise ExportError(f"reading {MESHOPT} needs meshopt; install it with: pip install 'hir[compress]'") from None
    values = meshopt.decode_gltf_buffer(
        stored,
        compression["count"],
        compression["byteStride"],
        compression["mode"],
        compression.get("filter", "NONE"),
    )
    return np.ascontiguousarray(values).tobytes()


def _floats(accessor: dict[str, Any], content: bytes, stride: int) -> NDArray[np.float32]:
    """Values (N, C) of normalised integers (glTF 2.0, section 3.11)."""
    (name, largest), width = _COMPONENT_TYPES[accessor["componentType"]], _WIDTHS[accessor["type"]]
    size = np.dtype(name).itemsize
    strides = (stride or width * size, size)
    codes: NDArray[Any] = np.ndarray((accessor["count"], width), name, content, accessor.get("byteOffset", 0), strides)
    return np.maximum(codes.astype(np.float32) / np.float32(largest), np.float32(-1))
