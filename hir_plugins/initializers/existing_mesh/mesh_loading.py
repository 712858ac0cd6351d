"""Reads the triangles of a mesh file, without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.conventions import flip_v, srgb_to_linear
from hir_exporters.reading.base_color_texture import named_files
from hir_exporters.reading.gltf_geometry.geometry_alone import STORED_UVS
from hir_exporters.reading.mesh_references import load_mesh_scene
from numpy.typing import NDArray

from hir_core.errors import CaptureError, HirError

if TYPE_CHECKING:
    import trimesh

_MAX_BYTES = 4 << 30


@dataclass(frozen=True, eq=False)
class LoadedMesh:
    """The triangles of a mesh file, its objects and materials joined."""

    positions: NDArray[np.float64]
    """(V, 3), one for each pair of position and texture coordinate; in the axes of the file."""
    faces: NDArray[np.int64]
    """(F, 3), indices of vertices."""
    uvs: NDArray[np.float32] | None
    """(V, 2), with the origin at the top left, the stored numbers of a glTF; None where a part has none."""
    colors: NDArray[np.float32] | None
    """Linear (V, 3); None where the file has no colours at its vertices."""


def load_mesh(path: Path) -> LoadedMesh:
    """The triangles of a file, with the stored vertices. `CaptureError` names the file and the remedy."""
    import trimesh

    if path.stat().st_size > _MAX_BYTES:
        raise CaptureError(f"{path} is larger than {_MAX_BYTES >> 30} GB; simplify it first")
    try:
        scene = load_mesh_scene(path, stored_uvs=True, process=False)
        placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
        meshes = [(scene.geometry[name], to_world) for to_world, name in placed]
        parts = [_part(mesh, to_world) for mesh, to_world in meshes if isinstance(mesh, trimesh.Trimesh)]
    except HirError as error:
        raise CaptureError(str(error)) from None
    except Exception as error:  # trimesh's loaders raise many types on broken files
        raise CaptureError(f"{path} cannot be read as a mesh ({' '.join(str(error).split())[:200]})") from None
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise CaptureError(f"{path} contains no triangles; give a mesh with faces")
    if not all(np.isfinite(part.positions).all() for part in parts):
        raise CaptureError(f"{path} has vertices that are NaN or infinite; export the mesh again")
    if any(part.faces.min() < 0 or part.faces.max() >= len(part.positions) for part in parts):
        raise CaptureError(f"{path} has triangles whose vertices do not exist; export the mesh again")
    return _joined(parts)


def files_of_mesh(path: Path) -> list[Path]:
    """The file of a mesh, and those that it names."""
    try:
        return [path, *named_files(path)]
    except HirError as error:
        raise CaptureError(str(error)) from None


def _part(mesh: trimesh.Trimesh, to_world: NDArray[np.float64]) -> LoadedMesh:
    """One mesh at its place. Its material is left out: copying it would decode its pictures."""
    import trimesh

    moved = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).apply_transform(to_world)
    return LoadedMesh(
        np.asarray(moved.vertices, np.float64),
        np.asarray(moved.faces, np.int64),
        _texture_coordinates(mesh),
        _vertex_colors(mesh),
    )


def _joined(parts: list[LoadedMesh]) -> LoadedMesh:
    """All parts as one mesh. trimesh's own join packs the pictures of several materials, and moves the coordinates."""
    offsets = np.cumsum([0, *(len(part.positions) for part in parts[:-1])])
    uvs = [part.uvs for part in parts if part.uvs is not None]
    colors = [part.colors for part in parts if part.colors is not None]
    return LoadedMesh(
        positions=np.concatenate([part.positions for part in parts]),
        faces=np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        uvs=np.concatenate(uvs) if len(uvs) == len(parts) else None,
        colors=np.concatenate(colors) if len(colors) == len(parts) else None,
    )


def _texture_coordinates(part: trimesh.Trimesh) -> NDArray[np.float32] | None:
    """UV per vertex (V, 2); None without them, or without a finite one for each vertex."""
    stored = part.vertex_attributes.get(STORED_UVS)
    from_trimesh = getattr(part.visual, "uv", None)
    if stored is not None:
        uvs = np.asarray(stored, np.float32)
    elif from_trimesh is not None:
        uvs = flip_v(np.asarray(from_trimesh, np.float32)).astype(np.float32)  # its origin is at the bottom left
    else:
        return None
    return uvs if len(uvs) == len(part.vertices) and np.isfinite(uvs).all() else None


def _vertex_colors(part: trimesh.Trimesh) -> NDArray[np.float32] | None:
    """Linear vertex colours (V, 3); None without them."""
    if getattr(part.visual, "kind", None) != "vertex":
        return None
    colors = np.asarray(part.visual.vertex_colors)  # type: ignore[union-attr] # of ColorVisuals, by its kind
    if len(colors) != len(part.vertices):
        return None
    return srgb_to_linear(colors[:, :3].astype(np.float32) / 255).astype(np.float32)
