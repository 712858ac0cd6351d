"""Initializer: a surface through the capture's oriented points, by screened Poisson reconstruction."""

from __future__ import annotations

from pathlib import Path
from typing import final

import numpy as np
from hir_exporters.files.subprocess_call import SubprocessCrashError, run_in_subprocess
from numpy.typing import NDArray

from hir_core.capture import Array, Capture, OrientedPoints
from hir_core.errors import CaptureError, StageError
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.options import PoissonOptions
from hir_plugins.initializers.surface.initial_scene import make_scene
from hir_plugins.initializers.surface.isosurface import keep_large_components
from hir_plugins.initializers.surface.mesh_cleaning import clean_mesh, edge_length


@final
class Poisson(Initializer):
    """Screened Poisson reconstruction (Kazhdan & Hoppe 2013), trimmed where the point density is low."""

    def __init__(self, config: PoissonOptions) -> None:
        self._config = config

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The unchanged capture, and the surface. Fewer than 100 oriented points raise `CaptureError`."""
        del scene, workspace
        points = capture.points
        if points is None or points.normals is None or len(points.positions) < 100:
            raise CaptureError(
                f"{capture.path}: poisson needs oriented points; run stereo before, such as: "
                '--set \'initializers=["colmap", "stereo", "poisson"]\''
            )
        positions, faces = poisson_surface(points, self._config)
        edge = edge_length(capture, positions, self._config.edge_pixels)
        positions, faces = clean_mesh(positions, faces, edge, self._config.min_component, self._config.seed)
        return capture, make_scene(positions, faces, capture, self._config.vertex_colors)


def poisson_surface(points: OrientedPoints, options: PoissonOptions) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and outward triangles (F, 3) through oriented points, at any scale of the world."""
    assert points.normals is not None
    center = points.positions.mean(axis=0)
    size = float(np.ptp(points.positions, axis=0).max()) or 1.0
    # about one octree cell per point: a surface has about 4^depth cells
    depth = options.depth or int(np.clip(np.round(np.log(len(points.positions)) / np.log(4)), 6, 9))
    arguments = {"positions": (points.positions - center) / size, "normals": points.normals, "depth": depth}
    try:  # open3d does not release Python's lock: in a subprocess, Ctrl-C and progress still work
        mesh = run_in_subprocess(
            "hir_plugins.initializers.poisson.screened_poisson:surface", arguments | {"trim": options.trim}
        )
    except SubprocessCrashError as error:
        raise StageError(f"poisson ended without a surface ({error}); leave it out of 'initializers'") from error
    return keep_large_components(mesh["positions"] * size + center, mesh["faces"], options.min_component)
