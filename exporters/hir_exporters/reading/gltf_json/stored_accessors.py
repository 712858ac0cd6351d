"""Values of the accessors of any glTF document, and a check of those of its meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import HirError, InputError
from hir_exporters.reading.mesh_references import check_references, gltf_content, uri_bytes

_COMPONENTS: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_CHECKED: Final = ("POSITION", "NORMAL", "TEXCOORD_0")

Buffer = Callable[[int], bytes]
"""The content of a buffer by its index."""


def buffers_of(path: Path, document: Mapping[str, Any], binary: bytes) -> Buffer:
    """Reads the buffers of a document; a missing file raises `InputError`."""

    def content(index: int) -> bytes:
        uri = document["buffers"][index].get("uri")
        found = binary if uri is None else uri_bytes(path, uri)
        if found is None:
            raise InputError(f"{path} names {uri[:80]!r}, which is not in its folder; put it beside the file")
        return found

    return content


def stored_values(document: Mapping[str, Any], index: int, buffer: Buffer) -> NDArray[Any] | None:
    """Values (N, C) of an accessor as they are stored (glTF 2.0, section 3.6.2).

    None where they are not simply there: compressed, sparse, or all 0 by definition.
    """
    accessor = document["accessors"][index]
    if accessor.get("bufferView") is None or accessor.get("sparse") is not None:
        return None
    view = document["bufferViews"][accessor["bufferView"]]
    if view.get("extensions"):
        return None
    kind, width = np.dtype(_COMPONENTS[accessor["componentType"]]), _WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    strides = (view.get("byteStride") or width * kind.itemsize, kind.itemsize)
    # numpy refuses a buffer that is too short
    values: NDArray[Any] = np.ndarray((accessor["count"], width), kind, buffer(view["buffer"]), start, strides)
    return values


def check_geometry(path: Path) -> None:
    """Raises `InputError` where the meshes of a .glb or .gltf have numbers that are not finite or wrong indices.

    Compressed and sparse values are left to the reader that decodes them.
    """
    check_references(path)
    try:
        document, binary = gltf_content(path)
        buffer = buffers_of(path, document, binary)
        for mesh in document.get("meshes", []):
            for primitive in mesh["primitives"]:
                _check_primitive(path, document, primitive, buffer)
    except HirError:
        raise
    except Exception as error:  # any structure may be missing or of another type
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(f"{path} cannot be read as glTF ({reason}); export it again") from error


def _check_primitive(path: Path, document: Mapping[str, Any], primitive: Mapping[str, Any], buffer: Buffer) -> None:
    attributes = primitive["attributes"]
    for name in _CHECKED:
        values = None if name not in attributes else stored_values(document, attributes[name], buffer)
        if values is not None and values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"{path}: {name} of a mesh has NaN or infinite numbers; export it again")
    if primitive.get("indices") is None or "POSITION" not in attributes:
        return
    indices = stored_values(document, primitive["indices"], buffer)
    count = document["accessors"][attributes["POSITION"]]["count"]
    if indices is not None and indices.size and int(indices.max()) >= count:
        raise InputError(f"{path}: a mesh has the index {int(indices.max())}, but {count} vertices; export it again")
