"""Values of the accessors of any glTF document, and a check of those of its meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import HirError, InputError
from hir_exporters.reading.gltf_geometry.gltf_decompression import view_content
from hir_exporters.reading.mesh_references import gltf_content, uri_bytes

_COMPONENTS: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_CHECKED: Final = ("POSITION", "NORMAL", "TEXCOORD_0")

Json = Mapping[str, Any]
"""An object of a glTF document."""

Buffer = Callable[[int], bytes]
"""The content of a buffer by its index."""


def buffers_of(path: Path, document: Json, binary: bytes) -> Buffer:
    """Reads the buffers of a document; a missing file raises `InputError`."""

    @cache
    def content(index: int) -> bytes:
        uri = document["buffers"][index].get("uri")
        found = binary if uri is None else uri_bytes(path, uri)
        if found is None:
            raise InputError(f"{path} names {uri[:80]!r}, which is not in its folder; put it beside the file")
        return found

    return content


def stored_values(document: Json, accessor: Json, buffer: Buffer, decompress: bool = False) -> NDArray[Any] | None:
    """Values (N, C) of an accessor as they are stored (glTF 2.0, section 3.6.2).

    None where they are not simply there: sparse, all 0 by definition, or, without `decompress`, in a compressed view.
    """
    if accessor.get("bufferView") is None or accessor.get("sparse") is not None:
        return None
    view = document["bufferViews"][accessor["bufferView"]]
    if view.get("extensions") and not decompress:
        return None
    return _values_in_view(view, accessor, accessor["componentType"], accessor["type"], accessor["count"], buffer)


def sparse_values(accessor: Json, document: Json, buffer: Buffer) -> tuple[NDArray[Any], NDArray[Any]]:
    """Indices (N,) and values (N, C) that a sparse accessor replaces (glTF 2.0, section 3.6.2.3)."""
    sparse, views = accessor["sparse"], document["bufferViews"]
    count, indices, values = sparse["count"], sparse["indices"], sparse["values"]
    replaced = _values_in_view(views[indices["bufferView"]], indices, indices["componentType"], "SCALAR", count, buffer)
    kind, width = accessor["componentType"], accessor["type"]
    return replaced[:, 0], _values_in_view(views[values["bufferView"]], values, kind, width, count, buffer)


def _values_in_view(view: Json, place: Json, component: int, kind: str, count: int, buffer: Buffer) -> NDArray[Any]:
    """Values (N, C) of a view from the `byteOffset` of `place` on."""
    number, width = np.dtype(_COMPONENTS[component]), _WIDTHS[kind]
    strides = (view.get("byteStride") or width * number.itemsize, number.itemsize)
    # numpy refuses a buffer that is too short
    return np.ndarray((count, width), number, view_content(view, buffer), place.get("byteOffset", 0), strides)


def check_geometry(path: Path) -> None:
    """Raises `InputError` where the meshes of a .glb or .gltf have numbers that are not finite or wrong indices.

    Compressed and sparse values are left to the reader that decodes them.
    """
    try:
        document, binary = gltf_content(path)
        buffer = buffers_of(path, document, binary)
        primitives = [primitive for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
        _check_finite(path, document, primitives, buffer)
        _check_indices(path, document, primitives, buffer)
    except HirError:
        raise
    except Exception as error:  # any structure may be missing or of another type
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(f"{path} cannot be read as glTF ({reason}); export it again") from error


def _check_finite(path: Path, document: Json, primitives: list[Json], buffer: Buffer) -> None:
    used = {(p["attributes"][name], name) for p in primitives for name in _CHECKED if name in p["attributes"]}
    for accessor, name in sorted(used):
        values = stored_values(document, document["accessors"][accessor], buffer)
        if values is not None and values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"{path}: {name} of a mesh has NaN or infinite numbers; export it again")


def _check_indices(path: Path, document: Json, primitives: list[Json], buffer: Buffer) -> None:
    used = {(p["indices"], p["attributes"]["POSITION"]) for p in primitives if p.get("indices") is not None}
    largest: dict[int, int] = {}
    for accessor, positions in sorted(used):
        if accessor not in largest:
            values = stored_values(document, document["accessors"][accessor], buffer)
            largest[accessor] = -1 if values is None or not values.size else int(values.max())
        count = document["accessors"][positions]["count"]
        if largest[accessor] >= count:
            raise InputError(f"{path}: a mesh has the index {largest[accessor]}, but {count} vertices; export it again")
