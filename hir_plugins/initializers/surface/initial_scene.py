"""The initial scene of a run: one mesh with vertex colours."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Array, Capture
from hir_core.scene import Mesh, Scene, Topology
from hir_plugins.initializers.surface.silhouette_fields import working_downsample
from hir_plugins.initializers.surface.vertex_colors import vertex_colors


def make_scene(positions: Array, faces: NDArray[np.int64], capture: Capture, colored: bool) -> Scene:
    """A scene of one mesh; its vertices are coloured from the photographs if `colored`."""
    colors = vertex_colors(positions, faces, capture.views, working_downsample(capture)) if colored else None
    return Scene(
        mesh=Mesh(
            positions=torch.from_numpy(positions.astype(np.float32)),
            topology=Topology(torch.from_numpy(faces)),
            vertex_colors=None if colors is None else torch.from_numpy(colors),
        )
    )
