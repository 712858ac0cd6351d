"""Screened Poisson reconstruction by open3d, for a subprocess: arrays in, arrays out, no other imports."""

from __future__ import annotations

import numpy as np
from hir_exporters.files.subprocess_call import Arrays
from numpy.typing import NDArray


def surface(
    positions: NDArray[np.float64], normals: NDArray[np.float64], depth: NDArray[np.int64], trim: NDArray[np.float64]
) -> Arrays:
    """Vertices and triangles through points (N, 3) in a unit box.

    The share `trim` of the vertices with the lowest point density is removed.
    """
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    mesh, density = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=int(depth), n_threads=1)
    if trim > 0:
        values = np.asarray(density)
        mesh.remove_vertices_by_mask(values < np.quantile(values, float(trim)))
    return {"positions": np.asarray(mesh.vertices), "faces": np.asarray(mesh.triangles).astype(np.int64)}
