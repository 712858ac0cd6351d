"""The true mesh of a made capture with as few triangles as photographs can tell apart."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.files.atomic import atomic_path
from hir_exporters.reading.mesh_references import load_mesh_scene

TRIANGLES: Final = 20_000
"""True meshes have 80,000 to 180,000 triangles, which take minutes to unwrap. With 20,000 an edge is about two pixels
of a made photograph."""


def write_simplified(source: Path, destination: Path, triangles: int = TRIANGLES) -> None:
    """Writes a mesh file with at most `triangles` triangles as PLY (Garland and Heckbert 1997), in the same axes."""
    import open3d

    loaded = load_mesh_scene(source, process=False).to_mesh()
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.asarray(loaded.vertices, np.float64)),
        open3d.utility.Vector3iVector(np.asarray(loaded.faces, np.int32)),
    )
    if len(mesh.triangles) > triangles:
        mesh = mesh.simplify_quadric_decimation(triangles)
    with atomic_path(destination) as temporary:
        open3d.io.write_triangle_mesh(temporary, mesh)
