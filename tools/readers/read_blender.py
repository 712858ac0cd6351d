"""Reads files with Blender's importers: `python read_blender.py OUTPUT.json FILE…` writes one list of descriptions.

Runs in the environment with bpy: `tools/setup.sh blender` makes it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector

INPUTS = {"color": "Base Color", "roughness": "Roughness", "normal": "Normal"}


def description(file: str) -> dict[str, Any]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if file.endswith((".glb", ".gltf")):
        bpy.ops.import_scene.gltf(filepath=file)
    elif file.endswith(".obj"):
        bpy.ops.wm.obj_import(filepath=file)
    else:
        bpy.ops.wm.usd_import(filepath=file, import_guide=True)  # collision shapes have the purpose guide
    bpy.context.view_layer.update()
    objects = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    if not objects:
        raise ValueError("no mesh was imported")
    points = [o.matrix_world @ Vector(corner) for o in objects for corner in o.bound_box]
    points = [(p.x, p.z, -p.y) for p in points]  # +Z up to +Y up
    material = objects[0].data.materials[0]
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    images = {slot: _image(shader.inputs[name]) for slot, name in INPUTS.items()}
    return {
        "triangles": sum(len(o.data.loop_triangles) or _triangles(o.data) for o in objects),
        "low": [min(p[k] for p in points) for k in range(3)],
        "high": [max(p[k] for p in points) for k in range(3)],
        "meshes": [o.name for o in objects],
        "textures": {slot: list(image.size) for slot, image in images.items() if image is not None},
    }


def _triangles(mesh: bpy.types.Mesh) -> int:
    mesh.calc_loop_triangles()
    return len(mesh.loop_triangles)


def _image(socket: bpy.types.NodeSocket) -> bpy.types.Image | None:
    """The image of the first texture node upstream of an input, with its pixels decoded."""
    for link in socket.links:
        node = link.from_node
        if node.type == "TEX_IMAGE":
            return node.image if node.image is not None and len(node.image.pixels) else None
        for upstream in node.inputs:
            found = _image(upstream)
            if found is not None:
                return found
    return None


def main(output: str, files: list[str]) -> None:
    found = []
    for file in files:
        try:
            found.append(description(file))
        except Exception as error:  # whatever a reader raises is its answer
            found.append({"error": " ".join(str(error).split())})
    Path(output).write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
