"""The exact reference: float64 areas of the union of a mesh's projected triangles, by shapely. Shares no code with
hir.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from hir_core.capture import Camera


def silhouette(positions: NDArray[np.float64], faces: NDArray[np.int64], camera: Camera) -> shapely.Geometry:
    """Union of all triangles that are not edge-on, cut at the frame."""
    local = positions @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = (local @ camera.intrinsics.T)[:, :2] / local[:, 2:]
    t = pixels[faces]
    u, v = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    t = t[np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) > 1e-12]
    return shapely.union_all(shapely.polygons(t)) & shapely.box(0, 0, camera.width, camera.height)


def area(positions: NDArray[np.float64], faces: NDArray[np.int64], camera: Camera) -> float:
    """In pixels."""
    return float(silhouette(positions, faces, camera).area)


def ramp_overlap(positions: NDArray[np.float64], faces: NDArray[np.int64], camera: Camera) -> float:
    """`∫ x / width` over the silhouette: area times centroid, exact. Linear, so interpolation between pixels is exact
    too.
    """
    shape = silhouette(positions, faces, camera)
    return float(shape.area * shape.centroid.x / camera.width) if shape.area else 0.0
