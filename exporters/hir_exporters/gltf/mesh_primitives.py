"""An asset's mesh as a glTF primitive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hir_exporters.asset import AssetMesh
from hir_exporters.gltf.binary import ELEMENT_ARRAY_BUFFER, BinaryWriter
from hir_exporters.mesh.unit_vectors import unit_tangents, unit_vectors

if TYPE_CHECKING:
    from pygltflib import Primitive


def add_primitive(mesh: AssetMesh, writer: BinaryWriter, material: int) -> Primitive:
    """Triangles with positions, normals, UVs and, where the mesh has them, tangents."""
    from pygltflib import Attributes, Primitive

    attributes = Attributes(
        POSITION=writer.accessor(mesh.positions, bounds=True),
        NORMAL=writer.accessor(unit_vectors(mesh.normals)),
        TEXCOORD_0=writer.accessor(mesh.uvs),
    )
    if mesh.tangents is not None:
        tangents = unit_tangents(mesh.tangents)
        attributes.TANGENT = writer.accessor(tangents)
    return Primitive(attributes=attributes, indices=add_indices(mesh, writer), material=material)


def add_indices(mesh: AssetMesh, writer: BinaryWriter) -> int:
    """Adds the triangles as 16-bit indices where they fit, else 32-bit, and returns the accessor's index.

    The largest value of an index type restarts primitives and is never used.
    """
    small = len(mesh.positions) <= np.iinfo(np.uint16).max
    indices = mesh.faces.reshape(-1).astype(np.uint16 if small else np.uint32)
    return writer.accessor(indices, ELEMENT_ARRAY_BUFFER)
