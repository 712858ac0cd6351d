"""How many levels the silhouette fit has, how fine its meshes are, and which views are held out."""

from __future__ import annotations

import numpy as np

from hir_core.capture import Camera
from hir_core.config import GeometrySettings
from hir_core.mesh.remeshing import surface_area
from hir_core.scene import Mesh
from hir_core.scene.silhouette_targets import SilhouetteTargets

FINAL_EDGE_PIXELS = 3.0
"""Edge length of the final mesh: a circle with a radius of 50 pixels is then off by 0.02 pixels. Longer edges lose thin
parts (docs/studies/carving_hollows.md)."""

TRIANGLES_MIN, TRIANGLES_MAX = 8_000, 400_000
"""Many small photographs resolve more than one of them: 80 views of 128² of a cow lost its ears and horns at 1,800
triangles (IoU of held-out views 0.952; 0.970 at 6,000, 0.971 at 20,000)."""

CLOSE_INITIAL_ERROR = 0.1
"""Below this median 1 − IoU the initial mesh is close: a coarser level would only lose its detail."""

MIN_TRIANGLES = 500
"""Of the coarsest level."""


def level_count(settings: GeometrySettings, initial_error: float) -> int:
    """How many meshes are fitted, coarse to fine; `initial_error` is the median 1 − IoU of the initial mesh."""
    if not settings.remesh:
        return 1
    return settings.levels if settings.levels > 0 else 1 if initial_error < CLOSE_INITIAL_ERROR else 3


def triangles_of_level(
    mesh: Mesh, targets: SilhouetteTargets, settings: GeometrySettings, level: int, levels: int
) -> int:
    """Triangles for `level`: each level has a quarter of the next one's."""
    return max(MIN_TRIANGLES, _final_triangles(mesh, targets, settings) // 4 ** (levels - 1 - level))


def _final_triangles(mesh: Mesh, targets: SilhouetteTargets, settings: GeometrySettings) -> int:
    if settings.triangles > 0:
        return settings.triangles
    pixel = float(np.median([_pixel_size(mesh, camera) for camera in targets.cameras]))
    positions = mesh.positions.detach().cpu().numpy().astype(np.float64)
    area = surface_area(positions, mesh.faces.cpu().numpy())
    count = area / (np.sqrt(3) / 4 * (FINAL_EDGE_PIXELS * pixel) ** 2)
    return int(np.clip(count, TRIANGLES_MIN, TRIANGLES_MAX))


def _pixel_size(mesh: Mesh, camera: Camera) -> float:
    """Width of a pixel at the centre of the mesh's bounds, in the world's unit."""
    positions = mesh.positions.detach().cpu().numpy().astype(np.float64)
    centre = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    depth = abs(float(camera.world_to_camera[2, :3] @ centre + camera.world_to_camera[2, 3]))
    return depth / camera.focal_length
