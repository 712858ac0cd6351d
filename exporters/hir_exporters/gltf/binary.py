"""The binary data of a glTF document: buffer views, accessors, and the .glb container."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hir_exporters.gltf import meshopt

if TYPE_CHECKING:
    from pygltflib import GLTF2

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class BinaryWriter:
    """Appends data to a document's buffer and adds its buffer views and accessors."""

    def __init__(self, document: GLTF2, compressed: bool = False) -> None:
        """`compressed`: encode the data of accessors with EXT_meshopt_compression; images are not changed."""
        self._document = document
        self._compressed = compressed
        self._chunks: list[bytes] = []
        self._length = 0
        self._uncompressed_length = 0

    def view(self, data: bytes, target: int | None = None, stride: int | None = None) -> int:
        """Adds a buffer view of `data`, aligned to four bytes, and returns its index."""
        from pygltflib import BufferView

        view = BufferView(buffer=0, byteOffset=self._length, byteLength=len(data), target=target, byteStride=stride)
        self._document.bufferViews.append(view)
        padded = data + b"\0" * (-len(data) % 4)
        self._chunks.append(padded)
        self._length += len(padded)
        return len(self._document.bufferViews) - 1

    def accessor(
        self, values: NDArray[Any], target: int = ARRAY_BUFFER, normalized: bool = False, bounds: bool = False
    ) -> int:
        """Adds an accessor of values (N,) or (N, C) and returns its index; rows are padded to four bytes."""
        from pygltflib import Accessor

        rows = np.ascontiguousarray(values.reshape(len(values), -1))
        width = rows.shape[1] * rows.dtype.itemsize
        stride = None
        if target == ARRAY_BUFFER and width % 4:
            stride = width + -width % 4
            padded = np.zeros((len(rows), stride), np.uint8)
            padded[:, :width] = rows.view(np.uint8).reshape(len(rows), width)
            data = padded.tobytes()
        else:
            data = rows.astype(rows.dtype.newbyteorder("<")).tobytes()
        view = self._meshopt_view(data, len(rows), target) if self._compressed else self.view(data, target, stride)
        accessor = Accessor(
            bufferView=view,
            byteOffset=0,
            componentType=_COMPONENTS[rows.dtype.name],
            normalized=normalized,
            count=len(rows),
            type=_TYPES[rows.shape[1]],
        )
        if bounds:
            accessor.min, accessor.max = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self._document.accessors.append(accessor)
        return len(self._document.accessors) - 1

    def _meshopt_view(self, data: bytes, count: int, target: int) -> int:
        """Adds a view of the fallback buffer, which is not stored; the view's extension has the compressed data."""
        from pygltflib import BufferView

        stride, triangles = len(data) // count, target == ELEMENT_ARRAY_BUFFER
        rows = np.frombuffer(data, f"<u{stride}" if triangles else np.uint8)
        stream = meshopt.encoded(rows if triangles else rows.reshape(count, stride), triangles)
        index = self.view(stream)
        compressed = self._document.bufferViews.pop(index)
        self._document.bufferViews.append(
            BufferView(
                buffer=1,
                byteOffset=self._uncompressed_length,
                byteLength=len(data),
                target=target,
                byteStride=None if triangles else stride,
                extensions={
                    meshopt.NAME: {
                        "buffer": 0,
                        "byteOffset": compressed.byteOffset,
                        "byteLength": compressed.byteLength,
                        "byteStride": stride,
                        "count": count,
                        "mode": "TRIANGLES" if triangles else "ATTRIBUTES",
                    }
                },
            )
        )
        self._uncompressed_length += len(data) + -len(data) % 4
        return index

    def add_buffers(self) -> None:
        """Adds the document's buffers with their sizes; call it last. The fallback buffer is marked as such."""
        from pygltflib import Buffer

        self._document.buffers.append(Buffer(byteLength=self._length))
        if self._uncompressed_length:
            self._document.buffers.append(
                Buffer(byteLength=self._uncompressed_length, extensions={meshopt.NAME: {"fallback": True}})
            )
            self._document.extensionsUsed.append(meshopt.NAME)
            self._document.extensionsRequired.append(meshopt.NAME)

    def accessor_without_data(
        self, count: int, kind: type[np.generic], width: int, bounds: tuple[NDArray[Any], NDArray[Any]] | None = None
    ) -> int:
        """Adds an accessor whose data an extension of the primitive provides; returns its index.

        `bounds` are the smallest and largest values.
        """
        from pygltflib import Accessor

        component = _COMPONENTS[np.dtype(kind).name]
        accessor = Accessor(byteOffset=None, componentType=component, normalized=False, count=count, type=_TYPES[width])
        if bounds is not None:
            accessor.min, accessor.max = bounds[0].tolist(), bounds[1].tolist()
        self._document.accessors.append(accessor)
        return len(self._document.accessors) - 1

    def data(self) -> bytes:
        """The content of the buffer so far."""
        return b"".join(self._chunks)


def glb_bytes(json_text: bytes, binary: bytes) -> bytes:
    """The .glb container (glTF 2.0, section 4.4) of a document and its buffer."""
    json_chunk = json_text + b" " * (-len(json_text) % 4)
    padding = b"\0" * (-len(binary) % 4)
    size = len(binary) + len(padding)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(json_chunk) + size, len(json_chunk), b"JSON")
    return b"".join([head, json_chunk, struct.pack("<I4s", size, b"BIN\0"), binary, padding])
