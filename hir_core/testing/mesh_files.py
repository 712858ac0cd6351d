"""Reads what an exporter wrote in a mesh file: corners with texture coordinates and normals, and the files named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class MeshFile:
    """The triangles of a file; `uvs` and `normals` are None where not every corner has one."""

    positions: NDArray[np.float64]
    """(F, 3, 3): faces, corners, coordinates."""
    uvs: NDArray[np.float64] | None
    """(F, 3, 2) as the file has them: v points up."""
    normals: NDArray[np.float64] | None
    """(F, 3, 3)."""
    has_material: bool
    missing: tuple[str, ...] = ()
    """Names in the file, and in its material libraries, of files that are not there."""


def surface_by_trimesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions (V, 3) and faces (F, 3) of a file, as trimesh reads it."""
    import trimesh

    mesh: Any = trimesh.load(path, process=False, force="mesh")
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def read_mesh_file(path: Path) -> MeshFile:
    """The triangles of an .obj file whose faces are triangles, or of what else trimesh reads."""
    if path.suffix.lower() == ".obj":
        return _read_obj(path)
    import trimesh

    mesh: Any = trimesh.load(path, process=False)  # with force="mesh" it loses the normals
    uvs = getattr(mesh.visual, "uv", None)
    normals = mesh.vertex_normals if "vertex_normals" in mesh._cache else None
    corners = [None if values is None else np.asarray(values, np.float64)[mesh.faces] for values in (uvs, normals)]
    return MeshFile(np.asarray(mesh.vertices, np.float64)[mesh.faces], corners[0], corners[1], False)


def _read_obj(path: Path) -> MeshFile:
    lines = [line.split(maxsplit=1) for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    values: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    faces, libraries = [], []
    for word, rest in (line for line in lines if len(line) == 2):
        if word in values:
            values[word].append([float(number) for number in rest.split()[: 2 if word == "vt" else 3]])
        elif word == "f":
            faces.append([(corner + "//").split("/")[:3] for corner in rest.split()])
        elif word == "mtllib":
            libraries.append(path.parent / rest.strip())
    named = [library for library in libraries if not library.is_file()]
    for library in libraries:
        named += [file for file in _maps(library) if not file.is_file()]
    corners = [_corners(values[word], faces, place) for place, word in enumerate(("v", "vt", "vn"))]
    assert corners[0] is not None
    return MeshFile(corners[0], corners[1], corners[2], bool(libraries), tuple(file.name for file in named))


def _corners(values: list[list[float]], faces: list[list[list[str]]], place: int) -> NDArray[np.float64] | None:
    """The value that each corner of each face names; None where one names none."""
    if any(not corner[place] for face in faces for corner in face):
        return None
    indices = np.array([[int(corner[place]) for corner in face] for face in faces])
    return np.array(values)[np.where(indices > 0, indices - 1, indices + len(values))]


def _maps(library: Path) -> list[Path]:
    """The pictures that a material library names: the last word of a statement, behind its options."""
    if not library.is_file():
        return []
    found = []
    for line in library.read_text(encoding="utf-8", errors="replace").splitlines():
        word, _, rest = line.strip().partition(" ")
        if (word.lower().startswith("map_") or word.lower() in ("norm", "bump", "disp", "decal", "refl")) and rest:
            name = rest.strip() if not rest.strip().startswith("-") else rest.split()[-1]
            found.append(library.parent / name)
    return found
