"""Reads the one mesh of an exported glTF file: accessors and nodes as glTF 2.0 defines them.

trimesh reads more kinds of files, but importing it takes half a second of processor time: most of a read-back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hir_exporters.collision_names import is_collision_name
from hir_exporters.errors import InputError

if TYPE_CHECKING:
    from pygltflib import GLTF2, Node

Array = NDArray[np.float64]

_TRIANGLES: Final = 4
_COMPONENTS: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class CornerMesh(NamedTuple):
    """Triangle corners (F, 3, C) in world axes."""

    positions: Array
    normals: Array
    uvs: Array


def corner_mesh(document: GLTF2, path: Path, buffer: Callable[[int], bytes]) -> CornerMesh:
    """The mesh of the document's scene without collision shapes; `buffer` returns the content of a buffer by index.

    Raises `InputError` unless there is one mesh of one primitive, uncompressed triangles with normals and texture
    coordinates. Damaged documents raise many types of errors.
    """
    placed = [(node, matrix) for node, matrix in _placed_nodes(document) if node.mesh is not None]
    placed = [(node, matrix) for node, matrix in placed if not is_collision_name(node.name or "")]
    if len(placed) != 1:
        raise InputError(f"{path} contains {len(placed)} meshes; an exported file has one")
    node, to_world = placed[0]
    primitives = document.meshes[node.mesh].primitives
    if len(primitives) != 1 or primitives[0].mode not in (None, _TRIANGLES):
        raise InputError(f"{path} has a mesh that is not one list of triangles; an exported file has one")

    def values(index: int | None, what: str) -> NDArray[Any]:
        if index is None:
            raise InputError(f"{path} has a mesh without {what}; an exported file has them")
        return _accessor_values(document, index, buffer)

    attributes = primitives[0].attributes
    faces = values(primitives[0].indices, "indices").astype(np.int64).reshape(-1, 3)
    positions = values(attributes.POSITION, "positions").astype(np.float64)[faces]
    normals = values(attributes.NORMAL, "normals").astype(np.float64)[faces]
    uvs = values(attributes.TEXCOORD_0, "texture coordinates").astype(np.float64)[faces]
    if not np.array_equal(to_world, np.eye(4)):
        positions = positions @ to_world[:3, :3].T + to_world[:3, 3]
        normals = normals @ np.linalg.inv(to_world[:3, :3])
    return CornerMesh(positions, normals, uvs)


def _placed_nodes(document: GLTF2) -> Iterator[tuple[Node, Array]]:
    """Nodes of the default scene with their matrices (4, 4) to world axes."""
    pending = [(index, np.eye(4)) for index in document.scenes[document.scene or 0].nodes]
    visited = set()
    while pending:
        index, parent = pending.pop()
        if index in visited:  # a cycle, or two parents, both of which glTF forbids
            raise InputError(f"node {index} occurs twice in the scene; export the file again")
        visited.add(index)
        node = document.nodes[index]
        matrix = parent @ _local_matrix(node)
        yield node, matrix
        pending += [(child, matrix) for child in node.children or []]


def _local_matrix(node: Node) -> Array:
    if node.matrix is not None:
        return np.asarray(node.matrix, np.float64).reshape(4, 4).T  # stored by columns
    matrix = np.eye(4)
    matrix[:3, 3] = node.translation or [0, 0, 0]
    x, y, z, w = node.rotation or [0, 0, 0, 1]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + 2 * (w * cross + cross @ cross)
    matrix[:3, :3] = rotation * np.asarray(node.scale or [1, 1, 1], np.float64)
    return matrix


def _accessor_values(document: GLTF2, index: int, buffer: Callable[[int], bytes]) -> NDArray[Any]:
    """Values (N, C) of an accessor (glTF 2.0, section 3.6.2). Raises `InputError` for sparse and normalised ones."""
    accessor = document.accessors[index]
    if accessor.sparse is not None or accessor.normalized or accessor.bufferView is None:
        raise InputError(f"accessor {index} is sparse, normalised or compressed; export the file without")
    view = document.bufferViews[accessor.bufferView]
    kind, width = np.dtype(_COMPONENTS[accessor.componentType]), _WIDTHS[accessor.type]
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    strides = (view.byteStride or width * kind.itemsize, kind.itemsize)
    # numpy refuses a buffer that is too short
    values: NDArray[Any] = np.ndarray((accessor.count, width), kind, buffer(view.buffer), start, strides)
    return values
