"""KHR_draco_mesh_compression: positions, normals, UVs and triangles in one Draco stream, encoded by DracoPy.

The order of vertices and triangles is preserved: the file is somewhat larger, and verification can compare it corner by
corner. The extension is required, because a reader without it finds no mesh.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hir_exporters.asset import AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.mesh.unit_vectors import unit_tangents, unit_vectors

if TYPE_CHECKING:
    from pygltflib import GLTF2, Primitive

NAME: Final = "KHR_draco_mesh_compression"

POSITION_BITS, NORMAL_BITS, UV_BITS = 16, 12, 14
"""Quantisation relative to the bounding box's longest side, in octahedral coordinates, and of the UV range."""

_COMPRESSION_LEVEL = 7  # of 10; the default of gltf-pipeline


def add_draco_primitive(document: GLTF2, mesh: AssetMesh, writer: BinaryWriter, material: int) -> Primitive:
    """The primitive with its attributes in a Draco stream; tangents are written as floats beside it."""
    from pygltflib import Attributes, Primitive

    stream, ids = _encoded(mesh)
    count = len(mesh.positions)
    small = count <= np.iinfo(np.uint16).max
    attributes = Attributes(
        POSITION=writer.accessor_without_data(count, np.float32, 3, (mesh.positions.min(0), mesh.positions.max(0))),
        NORMAL=writer.accessor_without_data(count, np.float32, 3),
        TEXCOORD_0=writer.accessor_without_data(count, np.float32, 2),
    )
    if mesh.tangents is not None:
        tangents = unit_tangents(mesh.tangents)
        attributes.TANGENT = writer.accessor(tangents)
    indices = writer.accessor_without_data(mesh.faces.size, np.uint16 if small else np.uint32, 1)
    primitive = Primitive(attributes=attributes, indices=indices, material=material)
    primitive.extensions = {NAME: {"bufferView": writer.view(stream), "attributes": ids}}
    document.extensionsUsed.append(NAME)
    document.extensionsRequired.append(NAME)
    return primitive


def _encoded(mesh: AssetMesh) -> tuple[bytes, dict[str, int]]:
    """The stream, and its identifier of each attribute."""
    try:
        import DracoPy
    except ImportError:
        raise ExportError("compression 'draco' needs DracoPy; install it with: pip install 'hir[compress]'") from None
    stream: bytes = DracoPy.encode(
        mesh.positions,
        mesh.faces.astype(np.uint32),
        quantization_bits=POSITION_BITS,
        compression_level=_COMPRESSION_LEVEL,
        preserve_order=True,
        tex_coord=mesh.uvs.astype(np.float64),
        normals=unit_vectors(mesh.normals).astype(np.float64),
        tex_coord_quantization_bits=UV_BITS,
        normal_quantization_bits=NORMAL_BITS,
    )
    decoded: Any = DracoPy.decode(stream)  # DracoPy has no type information
    if not np.array_equal(decoded.faces, mesh.faces) or len(decoded.points) != len(mesh.positions):
        raise ExportError("Draco changed the triangles of the mesh; write it without compression")
    kinds = DracoPy.AttributeType
    numbers = {a["attribute_type"]: a["unique_id"] for a in decoded.attributes}
    named = {"POSITION": kinds.POSITION, "NORMAL": kinds.NORMAL, "TEXCOORD_0": kinds.TEX_COORD}
    return stream, {name: int(numbers[kind]) for name, kind in named.items()}
