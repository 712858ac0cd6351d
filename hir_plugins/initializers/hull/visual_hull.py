"""Initializer: the visual hull of the masks, with vertex colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import final

import numpy as np

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.hull.hull_field import HullField
from hir_plugins.initializers.hull.hull_sampling import sample_hull
from hir_plugins.initializers.options import VisualHullOptions
from hir_plugins.initializers.surface.initial_scene import make_scene
from hir_plugins.initializers.surface.isosurface import extract_surface, keep_large_components
from hir_plugins.initializers.surface.mesh_cleaning import clean_mesh, edge_length
from hir_plugins.initializers.surface.silhouette_fields import MIN_MASK_SHARE, silhouette_fields, working_downsample
from hir_plugins.initializers.surface.unseen_surface import with_membranes
from hir_plugins.initializers.surface.volume import Volume


@final
class VisualHull(Initializer):
    """The largest object that fits all masks, but for a base that no photograph shows: a closed mesh with outward
    faces, at any position and scale.
    """

    def __init__(self, config: VisualHullOptions) -> None:
        self._config = config
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The unchanged capture, and the hull. Fewer than two masks with cameras raise `CaptureError`."""
        del scene, workspace
        volume = hull_volume(capture, self._config)
        positions, faces = keep_large_components(*extract_surface(volume), self._config.min_component)
        edge = edge_length(capture, positions, self._config.edge_pixels, volume.spacing)
        positions, faces = clean_mesh(positions, faces, edge, self._config.min_component, self._config.seed)
        if self._config.unseen_surface == "membrane":
            cameras = [view.camera for view in capture.views if view.camera is not None]
            positions, unseen = with_membranes(positions.astype(np.float64), faces, cameras)
            self._report = asdict(unseen)
        return capture, make_scene(positions, faces, capture, self._config.vertex_colors)

    def report(self) -> Mapping[str, object]:
        """The surface that no photograph shows, and how much of the volume membranes left out."""
        return self._report


def hull_volume(capture: Capture, options: VisualHullOptions) -> Volume:
    """The hull of a capture's masks, sampled on a grid."""
    posed, downsample = [v for v in capture.views if v.camera is not None], working_downsample(capture)
    fields = silhouette_fields(posed, downsample)
    if len(fields) < 2:
        masks = [mask for view in posed if (mask := view.pixels(downsample).mask) is not None]
        if len(masks) >= 2:
            full = sum(bool(mask.mean() >= 1 - MIN_MASK_SHARE) for mask in masks)
            raise CaptureError(
                f"{capture.path}: {len(fields)} of {len(masks)} masks have an outline, a visual hull needs two: "
                f"{full} show only object and {len(masks) - len(fields) - full} only background; check the alpha "
                "channel or the masks, or name a mask source, such as: --set 'masks=[\"grabcut\"]'"
            )
        if len(posed) < 2:
            raise CaptureError(
                f"{capture.path}: a visual hull needs cameras of at least two photographs, there are {len(posed)}; "
                'add photographs, or have the cameras solved: --set \'initializers=["colmap", "visual_hull"]\''
            )
        raise CaptureError(
            f"{capture.path}: a visual hull needs masks of at least two photographs, there are "
            f"{len(masks)}; add an alpha channel or a folder of masks, or name a mask source, such as: "
            "--set 'masks=[\"grabcut\"]'"
        )
    field = HullField(fields, options.tolerated_views, options.min_views)
    return sample_hull(field, options.pixels_per_voxel, options.max_resolution, options.drop_bad_views)
