"""Reads files with trimesh: `python read_trimesh.py FILE…` prints one JSON list of descriptions."""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import trimesh


def description(file: str) -> dict[str, Any]:
    scene = trimesh.load_scene(file)
    nodes = [str(node) for node in scene.graph.nodes_geometry]
    points = np.concatenate([_points(scene, node) for node in nodes])
    visuals = [scene.geometry[scene.graph[node][1]].visual for node in nodes]
    material = next(visual.material for visual in visuals if hasattr(visual, "material"))  # hulls have none
    slots = {
        "color": getattr(material, "baseColorTexture", None) or getattr(material, "image", None),
        "roughness": getattr(material, "metallicRoughnessTexture", None),
        "normal": getattr(material, "normalTexture", None),
    }
    return {
        "triangles": sum(len(scene.geometry[scene.graph[node][1]].faces) for node in nodes),
        "low": points.min(axis=0).tolist(),
        "high": points.max(axis=0).tolist(),
        "meshes": nodes,
        "textures": {slot: list(image.size) for slot, image in slots.items() if image is not None},
    }


def _points(scene: trimesh.Scene, node: str) -> np.ndarray:
    matrix, geometry = scene.graph[node]
    return scene.geometry[geometry].vertices @ matrix[:3, :3].T + matrix[:3, 3]


def main(files: list[str]) -> None:
    found = []
    for file in files:
        try:
            found.append(description(file))
        except Exception as error:  # whatever a reader raises is its answer
            found.append({"error": f"{type(error).__name__}: {error}"})
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
