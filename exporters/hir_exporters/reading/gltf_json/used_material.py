"""The material of a glTF scene: that of the triangles that its nodes place, not of all that the document defines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hir_exporters.collision_names import is_collision_name
from hir_exporters.errors import InputError
from hir_exporters.reading.gltf_json.stored_accessors import Json

_TRIANGLE_MODES: Final = (4, 5, 6)
"""Triangles, strips and fans."""


def placed_primitives(document: Json) -> Iterator[Json]:
    """The primitives of triangles that the document's scene places, without collision shapes."""
    nodes, scenes = document.get("nodes", []), document.get("scenes", [])
    scene = scenes[document.get("scene", 0)] if scenes else {"nodes": range(len(nodes))}
    pending, visited = list(scene.get("nodes", [])), set()
    while pending:
        index = pending.pop(0)
        if index in visited:
            continue
        visited.add(index)
        node = nodes[index]
        pending += node.get("children") or []
        if node.get("mesh") is not None and not is_collision_name(node.get("name") or ""):
            yield from (
                primitive
                for primitive in document["meshes"][node["mesh"]]["primitives"]
                if primitive.get("mode", 4) in _TRIANGLE_MODES
            )


def used_material(document: Json, path: Path) -> Json | None:
    """The material of the placed triangles; None where they have none. Raises `InputError` where they have several.

    Materials that are equal apart from their names are one.
    """
    indices = list(dict.fromkeys(primitive.get("material") for primitive in placed_primitives(document)))
    found: list[Json | None] = []
    for index in indices:
        material = None if index is None else _without_name(document["materials"][index])
        if material not in found:
            found.append(material)
    if len(found) > 1:
        bare = ", one of them glTF's default, because it names none for some triangles" if None in found else ""
        raise InputError(f"{path} has {len(found)} materials{bare}; an asset has one: merge them first")
    return found[0] if found else None


def _without_name(material: Json) -> Json:
    return {key: value for key, value in material.items() if key not in ("name", "extras")}
