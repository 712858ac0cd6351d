"""Initializer: the visual hull of the masks, with vertex colours."""
# ruff: noqa: TID253 - loaded when it runs

from __future__ import annotations

from pathlib import Path
from typing import final

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Array, Capture
from hir_core.errors import CaptureError
from hir_core.interfaces import Initializer
from hir_core.scene import Mesh, Scene, Topology
from hir_plugins.initializers.carving import Carver, Volume, carve
from hir_plugins.initializers.cleaning import cleaned, edge_length
from hir_plugins.initializers.options import VisualHullOptions
from hir_plugins.initializers.silhouette_fields import silhouette_fields, working_downsample
from hir_plugins.initializers.surface import extract_surface, keep_large_components
from hir_plugins.initializers.vertex_colors import vertex_colors


@final
class VisualHull(Initializer):
    """The largest object that fits all masks: closed, outward, of any place and size."""

    def __init__(self, config: VisualHullOptions) -> None:
        self._config = config

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture as it is, and the hull. Fewer than two masks with cameras raise `CaptureError`."""
        del scene, workspace
        volume = hull_volume(capture, self._config)
        positions, faces = keep_large_components(*extract_surface(volume), self._config.min_component)
        edge = edge_length(capture, positions, self._config.edge_pixels, volume.spacing)
        positions, faces = cleaned(positions, faces, edge, self._config.min_component)
        return capture, make_scene(positions, faces, capture, self._config.vertex_colors)


def hull_volume(capture: Capture, options: VisualHullOptions) -> Volume:
    """The hull of a capture's masks as a sampled field."""
    fields = silhouette_fields([v for v in capture.views if v.camera is not None], working_downsample(capture))
    if len(fields) < 2:
        raise CaptureError(
            f"{capture.path}: a visual hull needs masks and cameras of at least two photographs, there are "
            f"{len(fields)}; give images with alpha or a masks folder, "
            "or name a mask source, such as: --set 'masks=[\"grabcut\"]'"
        )
    carver = Carver(fields, options.tolerated_views, options.min_views)
    return carve(carver, options.pixels_per_voxel, options.max_resolution, options.drop_bad_views)


def make_scene(positions: Array, faces: NDArray[np.int64], capture: Capture, colored: bool) -> Scene:
    """A scene of one mesh, coloured from the photographs where asked."""
    colors = vertex_colors(positions, faces, capture.views, working_downsample(capture)) if colored else None
    return Scene(
        mesh=Mesh(
            positions=torch.from_numpy(positions.astype(np.float32)),
            topology=Topology(torch.from_numpy(faces)),
            vertex_colors=None if colors is None else torch.from_numpy(colors),
        )
    )
