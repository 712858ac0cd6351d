"""Initializer: sinks the openings of a hull that no outline shows, such as those of a mug, a vase or a box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from hir_core.capture import Array, Capture
from hir_core.errors import StageError
from hir_core.mesh.exposure_differences import exposure_corrections
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_core.scene.frames import move_scene
from hir_plugins.initializers.hollows.photo_prediction import BlurredPhotograph, blurred_photographs
from hir_plugins.initializers.hollows.search import Hollow, find_hollows
from hir_plugins.initializers.hollows.sunk_volume import sunk
from hir_plugins.initializers.options import HollowsOptions
from hir_plugins.initializers.stereo.stereo_photographs import evenly_distributed_views
from hir_plugins.initializers.surface.initial_scene import make_scene
from hir_plugins.initializers.surface.isosurface import extract_surface, keep_large_components
from hir_plugins.initializers.surface.mesh_cleaning import clean_mesh, edge_length, pixel_size
from hir_plugins.initializers.surface.swept_surface import SweptSurface, signed_distance_volume
from hir_plugins.initializers.surface.vertex_colors import vertex_normals
from hir_plugins.initializers.surface.volume import Volume

if TYPE_CHECKING:
    from hir_plugins.initializers.hollows.rendered_search import RenderedHollow

SEARCH_VOXELS = 64
"""Along the longest side of the object, where openings are looked for."""

BLUR_VOXELS = 1.0
"""Standard deviation of the blur of photographs, in voxels of the search: finer detail needs a more exact surface."""

_MIN_COMPONENT = 0.02


@final
class Hollows(Initializer):
    """Hollows of a surface that photographs show and outlines do not."""

    def __init__(self, config: HollowsOptions) -> None:
        self._config = config
        self._report: dict[str, object] = {"hollows": []}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The unchanged capture, and the surface with its hollows. Without a surface `StageError`.

        Where the scene has a material and a light, hollows are sunk that render more like the photographs; else those
        whose points look alike from all photographs.
        """
        del workspace
        if scene is None:
            raise StageError(
                "hollows needs a surface; run visual_hull before: "
                '--set \'initializers=["visual_hull", "hollows", "stereo"]\''
            )
        if self._config.max_hollows == 0:
            return capture, scene
        positions = scene.mesh.positions.detach().cpu().numpy().astype(np.float64)
        faces = scene.mesh.faces.cpu().numpy()
        middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
        extent = float(np.ptp(positions, axis=0).max())
        # around the origin and of size 1, because rays are cast in single precision
        unit = np.diag([1 / extent, 1 / extent, 1 / extent, 1.0])
        unit[:3, 3] = -middle / extent
        vertices = (positions - middle) / extent
        moved = capture.transformed(unit)
        most, takes = self._config.max_photographs, capture.take_numbers
        used = evenly_distributed_views(moved.cameras, np.zeros(3), most, takes)
        moved = replace(moved, views=tuple(moved.views[i] for i in used))
        surface = SweptSurface(vertices, faces)
        search = signed_distance_volume(surface, vertices, 1 / SEARCH_VOXELS)
        photographs = blurred_photographs(moved, BLUR_VOXELS * search.spacing)
        found: Sequence[Hollow | RenderedHollow]
        if scene.material is not None and scene.environment is not None:
            found = self._rendered_hollows(search, photographs, move_scene(scene, unit), capture.takes)
        else:
            factors = exposure_corrections(vertices, vertex_normals(vertices, faces), faces, moved)
            if factors is not None and len(photographs) == len(factors):  # those without a mask are left out
                photographs = [each.multiplied(row) for each, row in zip(photographs, factors, strict=True)]
            found = find_hollows(search, photographs, self._config.seed, self._config.max_hollows)
        self._report = {"hollows": [_described(hollow, search.spacing * extent) for hollow in found]}
        if not found:
            return capture, scene
        pixel = pixel_size(moved.cameras, np.zeros(3))
        spacing = max(self._config.pixels_per_voxel * pixel, 1 / self._config.max_resolution)
        volume = signed_distance_volume(surface, vertices, spacing)
        for hollow in found:
            volume = sunk(volume, search, hollow.opening, hollow.depth, hollow.wall)
        carved, triangles = keep_large_components(*extract_surface(volume), min_share=_MIN_COMPONENT)
        world: Array = carved * extent + middle
        edge = edge_length(capture, world, self._config.edge_pixels, spacing * extent)
        world, triangles = clean_mesh(world, triangles, edge, _MIN_COMPONENT, self._config.seed)
        return capture, make_scene(world, triangles, capture, self._config.vertex_colors)

    def _rendered_hollows(
        self, search: Volume, photographs: Sequence[BlurredPhotograph], scene: Scene, takes: Sequence[str]
    ) -> list[RenderedHollow]:
        from hir_plugins.initializers.hollows.rendered_prediction import Appearance
        from hir_plugins.initializers.hollows.rendered_search import find_rendered_hollows

        appearance = Appearance.of(scene, takes)
        return find_rendered_hollows(search, photographs, appearance, self._config.seed, self._config.max_hollows)

    def report(self) -> Mapping[str, object]:
        """The hollows: depth in the capture's unit, and the share of the variance of their pixels that they explain."""
        return self._report


def _described(hollow: Hollow | RenderedHollow, voxel: float) -> dict[str, object]:
    described: dict[str, object] = {
        "depth": round(hollow.depth * voxel, 5),
        "rounding": hollow.opening.rounding,
        "explained_before": round(hollow.explained_before, 4),
        "explained": round(hollow.explained, 4),
        "gain_in_standard_errors": round(hollow.gain, 2),
    }
    if isinstance(hollow, Hollow):
        return described | {
            "explained_by_reflection": round(hollow.explained_by_reflection, 4),
            "explained_from_far": round(hollow.explained_from_far, 4),
        }
    return described | {
        "share_of_error_saved": round(hollow.reduction, 4),
        "explained_by_maps": round(hollow.explained_by_maps, 4),
    }
