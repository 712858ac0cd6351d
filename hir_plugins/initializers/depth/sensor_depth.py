"""Initializer: the visual hull, carved by the depths that a sensor measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import final

import numpy as np

from hir_core.capture import Capture
from hir_core.capture.depth_samples import depth_noise
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.depth.sensor_maps import sensor_map
from hir_plugins.initializers.hull.visual_hull import hull_volume
from hir_plugins.initializers.options import SensorDepthOptions, VisualHullOptions
from hir_plugins.initializers.stereo.depth_fusion import carve_depths, smoothed_carving
from hir_plugins.initializers.surface.initial_scene import make_scene
from hir_plugins.initializers.surface.isosurface import extract_surface, keep_large_components
from hir_plugins.initializers.surface.mesh_cleaning import clean_mesh, edge_length

_MIN_COMPONENT = 0.02
"""Connected components with less than this share of the largest component's area are removed."""

_MAX_DEPTH_BEHIND = 3.0
"""Voxels, or standard deviations of noise, behind a depth that count as inside: more would fill the cavities of thin
walls."""


@final
class SensorDepth(Initializer):
    """A closed mesh with the outlines of the masks and the cavities that depth maps show."""

    def __init__(self, config: SensorDepthOptions) -> None:
        self._config = config
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The unchanged capture, and the carved hull. Captures without depth maps raise `CaptureError`."""
        del scene, workspace
        options = self._config
        capture.cameras  # noqa: B018 - an error names the view without one
        # maps are read twice, because all of them at once may not fit into memory
        found = (view.measured_depth() for view in capture.views)
        noises = [depth_noise(depth[1]) for depth in found if depth is not None]
        if not noises:
            raise CaptureError(
                f"{capture.path}: no photograph has a depth map; leave sensor_depth out of 'initializers', or name the "
                "depth maps in the file of the cameras (docs/captures.md)"
            )
        hull = hull_volume(
            capture,
            VisualHullOptions(pixels_per_voxel=options.pixels_per_voxel, max_resolution=options.max_resolution),
        )
        noise = float(np.median(noises))
        usable = (sensor_map(view, noise) for view in capture.views)
        maps = (depth_map for depth_map in usable if depth_map is not None)
        volume = smoothed_carving(hull, carve_depths(hull, maps, options.min_weight, noise, _MAX_DEPTH_BEHIND))
        removed = (hull.values > 0) & (volume.values <= 0)
        self._report = {
            "depth_maps": len(noises),
            "depth_noise_voxels": round(noise / hull.spacing, 3),
            "carved_share": round(float(removed.sum() / max((hull.values > 0).sum(), 1)), 5),
        }
        positions, faces = keep_large_components(*extract_surface(volume), _MIN_COMPONENT)
        edge = edge_length(capture, positions, options.edge_pixels, volume.spacing)
        positions, faces = clean_mesh(positions, faces, edge, _MIN_COMPONENT, options.seed)
        return capture, make_scene(positions, faces, capture, options.vertex_colors)

    def report(self) -> Mapping[str, object]:
        """The number of depth maps, their noise in voxels, and the share of the hull that they carved away."""
        return self._report
