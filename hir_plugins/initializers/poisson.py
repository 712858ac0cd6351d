"""Initializer: a surface through the capture's oriented points by screened Poisson reconstruction."""
# ruff: noqa: TID253 - loaded when it runs

from __future__ import annotations

from pathlib import Path
from typing import final

import numpy as np
import open3d
from numpy.typing import NDArray

from hir_core.capture import Array, Capture, OrientedPoints
from hir_core.errors import CaptureError
from hir_core.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.cleaning import cleaned, edge_length
from hir_plugins.initializers.options import PoissonOptions
from hir_plugins.initializers.surface import keep_large_components
from hir_plugins.initializers.visual_hull import make_scene


@final
class Poisson(Initializer):
    """Screened Poisson (Kazhdan & Hoppe 2013); where points are scarce its surface is cut off."""

    def __init__(self, config: PoissonOptions) -> None:
        self._config = config

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture as it is, and the surface. Fewer than 100 oriented points are a `CaptureError`."""
        del scene, workspace
        points = capture.points
        if points is None or points.normals is None or len(points.positions) < 100:
            raise CaptureError(f"{capture.path}: poisson needs oriented points; run stereo before, such as: "
                               "--set 'initializers=[\"colmap\", \"stereo\", \"poisson\"]'")  # fmt: skip
        positions, faces = poisson_surface(points, self._config)
        edge = edge_length(capture, positions, self._config.edge_pixels)
        positions, faces = cleaned(positions, faces, edge, self._config.min_component)
        return capture, make_scene(positions, faces, capture, self._config.vertex_colors)


def poisson_surface(points: OrientedPoints, options: PoissonOptions) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and outward triangles through oriented points, in any scale of the world."""
    assert points.normals is not None
    center = points.positions.mean(axis=0)
    size = float(np.ptp(points.positions, axis=0).max()) or 1.0
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector((points.positions - center) / size))
    cloud.normals = open3d.utility.Vector3dVector(points.normals)
    # an octree cell for each point or so on a surface: cells ~ 4^depth
    depth = options.depth or int(np.clip(np.round(np.log(len(points.positions)) / np.log(4)), 6, 9))
    mesh, density = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=1)
    if options.trim > 0:
        values = np.asarray(density)
        mesh.remove_vertices_by_mask(values < np.quantile(values, options.trim))
    positions = np.asarray(mesh.vertices) * size + center
    faces = np.asarray(mesh.triangles).astype(np.int64)
    return keep_large_components(positions, faces, options.min_component)
