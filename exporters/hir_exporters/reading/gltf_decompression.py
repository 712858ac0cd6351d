"""A glTF file in terms that every reader knows: streams of EXT_meshopt_compression decoded, steps of
KHR_mesh_quantization as floats. trimesh knows neither.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import ExportError, InputError

if TYPE_CHECKING:
    from pygltflib import GLTF2

MESHOPT: Final = "EXT_meshopt_compression"
EXPANDED: Final = frozenset({MESHOPT, "KHR_mesh_quantization"})
"""Extensions that `plain_glb` does away with."""

_KINDS: Final = {5120: ("<i1", 127), 5121: ("<u1", 255), 5122: ("<i2", 32767), 5123: ("<u2", 65535)}
"""Type and largest value."""

_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def plain_glb(document: GLTF2, buffer: Callable[[int], bytes]) -> bytes:
    """A .glb of the document without `EXPANDED`; `buffer` gives the bytes of the buffers that it names.

    Images beside the file stay beside it. Raises `InputError` for a view that says two sizes, `ExportError` where the
    library meshopt is missing.
    """
    plain = json.loads(document.gltf_to_json())
    parts = [_content(view, buffer) for view in plain["bufferViews"]]
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
        view |= {"buffer": 0, "byteOffset": start}
        start += len(part)
    plain["buffers"] = [{"byteLength": start}]
    for key in ("extensionsUsed", "extensionsRequired"):
        plain[key] = [name for name in plain.get(key, []) if name not in EXPANDED]
    text = json.dumps({key: value for key, value in plain.items() if value != []}).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + start)
    return b"".join(
        [head, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", start, b"BIN\0"), *padded]
    )


def _content(view: dict[str, Any], buffer: Callable[[int], bytes]) -> bytes:
    """Bytes of a view, decoded; it loses its extension."""
    said = view.pop("extensions", {}).get(MESHOPT)
    start = (said or view).get("byteOffset", 0)
    stored = buffer((said or view)["buffer"])[start : start + (said or view)["byteLength"]]
    if said is None:
        return stored
    if said["count"] * said["byteStride"] != view["byteLength"]:
        raise InputError(f"a buffer view of {view['byteLength']} bytes is compressed from another number of them")
    try:
        import meshopt
    except ImportError:
        raise ExportError(f"reading {MESHOPT} needs meshopt; install it with: pip install 'hir[compress]'") from None
    values = meshopt.decode_gltf_buffer(
        stored, said["count"], said["byteStride"], said["mode"], said.get("filter", "NONE")
    )
    return np.ascontiguousarray(values).tobytes()


def _floats(accessor: dict[str, Any], content: bytes, stride: int) -> NDArray[np.float32]:
    """Values (N, C) of normalised integers (glTF 2.0, section 3.11)."""
    (name, largest), width = _KINDS[accessor["componentType"]], _WIDTHS[accessor["type"]]
    size = np.dtype(name).itemsize
    places = (accessor["count"], width), name, content, accessor.get("byteOffset", 0), (stride or width * size, size)
    values: NDArray[np.float32] = np.ndarray(*places).astype(np.float32)
    return np.maximum(values / np.float32(largest), np.float32(-1))
