"""Reads files with assimp: `python read_assimp.py FILE…` prints one JSON list of descriptions.

assimp_py gives the names of textures and no pixels, so only the names are reported.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Any

import assimp_py
import numpy as np

TEXTURE_TYPES = {"color": (1, 12), "roughness": (16,), "normal": (6, 5)}
"""aiTextureType: diffuse 1, base colour 12, diffuse roughness 16, normals 6, height 5 (map_bump of .mtl)."""


def description(file: str) -> dict[str, Any]:
    scene = assimp_py.import_file(file, assimp_py.Process_Triangulate)
    placed = list(_placed(scene.root_node, np.eye(4)))
    corners, triangles = [], 0
    for index, _, matrix in placed:
        mesh = scene.meshes[index]
        vertices = np.asarray(mesh.vertices, np.float64).reshape(-1, 3)
        corners.append(vertices @ matrix[:3, :3].T + matrix[:3, 3])
        triangles += mesh.num_faces
    points = np.concatenate(corners)
    names = scene.materials[scene.meshes[placed[0][0]].material_index]["TEXTURES"]
    textures = {slot: "named" for slot, kinds in TEXTURE_TYPES.items() if any(names.get(kind) for kind in kinds)}
    return {
        "triangles": triangles,
        "low": points.min(axis=0).tolist(),
        "high": points.max(axis=0).tolist(),
        "meshes": [name for _, name, _ in placed],
        "textures": textures,
    }


def _placed(node: Any, parent: np.ndarray) -> Iterator[tuple[int, str, np.ndarray]]:
    """Index of the mesh, name of the node and matrix of each mesh in the scene."""
    matrix = parent @ np.array(node.transformation)
    for index in node.mesh_indices:
        yield index, node.name, matrix
    for child in node.children:
        yield from _placed(child, matrix)


def main(files: list[str]) -> None:
    found = []
    for file in files:
        try:
            found.append(description(file))
        except Exception as error:  # whatever a reader raises is its answer
            found.append({"error": str(error)})
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
