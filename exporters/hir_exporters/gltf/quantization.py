"""KHR_mesh_quantization: a mesh of half the size, for readers that have the extension.

Positions become 16-bit integers over the bounding box, which the node scales back; normals and tangents have 8 bits,
UVs in [0, 1] have 16 bits. The extension is required, because a reader without it shows a wrong mesh.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hir_exporters.asset import AssetMesh
from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.gltf.mesh_primitives import add_indices
from hir_exporters.mesh.unit_vectors import unit_tangents, unit_vectors

if TYPE_CHECKING:
    from pygltflib import GLTF2, Node, Primitive

NAME = "KHR_mesh_quantization"


def add_quantized_primitive(
    document: GLTF2, mesh: AssetMesh, writer: BinaryWriter, material: int, node: Node
) -> Primitive:
    """The primitive; `node` gets the translation and scale that undo the quantisation (1/65534 of the box)."""
    from pygltflib import Attributes, Primitive

    low, high = mesh.positions.min(axis=0).astype(np.float64), mesh.positions.max(axis=0).astype(np.float64)
    center, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-30)
    node.translation, node.scale = center.tolist(), [half] * 3
    steps = np.rint((mesh.positions - center) / half * 32767).astype(np.int16)
    attributes = Attributes(
        POSITION=writer.accessor(steps, normalized=True, bounds=True),
        NORMAL=writer.accessor(np.rint(unit_vectors(mesh.normals) * 127).astype(np.int8), normalized=True),
    )
    if mesh.uvs.min() >= 0 and mesh.uvs.max() <= 1:
        attributes.TEXCOORD_0 = writer.accessor(np.rint(mesh.uvs * 65535).astype(np.uint16), normalized=True)
    else:
        attributes.TEXCOORD_0 = writer.accessor(mesh.uvs)
    if mesh.tangents is not None:
        tangents = unit_tangents(mesh.tangents)
        attributes.TANGENT = writer.accessor(np.rint(tangents * 127).astype(np.int8), normalized=True)
    document.extensionsUsed.append(NAME)
    document.extensionsRequired.append(NAME)
    return Primitive(attributes=attributes, indices=add_indices(mesh, writer), material=material)
