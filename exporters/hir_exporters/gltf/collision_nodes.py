"""Convex hulls as nodes that game engines read as collision shapes by their names, and readers of meshes skip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from hir_exporters.collision_names import collision_name
from hir_exporters.gltf.binary import ELEMENT_ARRAY_BUFFER, BinaryWriter
from hir_exporters.mesh.convex_decomposition import ConvexHull

if TYPE_CHECKING:
    from pygltflib import GLTF2


def add_collision_nodes(
    document: GLTF2, hulls: Sequence[ConvexHull], target: Literal["unreal", "godot"], name: str, writer: BinaryWriter
) -> None:
    """Adds a node and a mesh without material for each hull to the document's scene; `name` is that of the asset."""
    from pygltflib import Attributes, Mesh, Node, Primitive

    for index, hull in enumerate(hulls):
        primitive = Primitive(
            attributes=Attributes(POSITION=writer.accessor(hull.positions, bounds=True)),
            indices=writer.accessor(hull.faces.astype("uint32").reshape(-1, 1), ELEMENT_ARRAY_BUFFER),
        )
        hull_name = collision_name(target, name, index)
        document.meshes.append(Mesh(name=hull_name, primitives=[primitive]))
        document.scenes[0].nodes.append(len(document.nodes))
        document.nodes.append(Node(name=hull_name, mesh=len(document.meshes) - 1))
