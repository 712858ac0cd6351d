"""Reads the triangles of a mesh file, without torch."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.reading.mesh_references import load_mesh_scene

from hir_core.errors import CaptureError, HirError

if TYPE_CHECKING:
    import trimesh

_MAX_BYTES = 4 << 30


def load_mesh(path: Path) -> trimesh.Trimesh:
    """The file's triangles as one `trimesh.Trimesh`, with the stored vertices; several objects are joined."""
    import trimesh

    if path.stat().st_size > _MAX_BYTES:
        raise CaptureError(f"{path} is larger than {_MAX_BYTES >> 30} GB; simplify it first")
    try:
        mesh = load_mesh_scene(path, process=False).to_mesh()
    except HirError as error:
        raise CaptureError(str(error)) from None
    except Exception as error:  # trimesh's loaders raise many types on broken files
        raise CaptureError(f"{path} cannot be read as a mesh ({' '.join(str(error).split())[:200]})") from None
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise CaptureError(f"{path} contains no triangles; give a mesh with faces")
    if not np.isfinite(mesh.vertices).all():
        raise CaptureError(f"{path} has vertices that are NaN or infinite; export the mesh again")
    faces = np.asarray(mesh.faces)
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        raise CaptureError(f"{path} has triangles whose vertices do not exist; export the mesh again")
    return mesh
