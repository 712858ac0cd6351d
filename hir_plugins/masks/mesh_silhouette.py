"""Mask source: the silhouette of a mesh that is already there, such as a scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.errors import StageError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import MaskSource

if TYPE_CHECKING:
    from hir_core.scene import Scene


LINES_PER_PIXEL = 8
"""Rows and columns on which coverage is exact: with 4 a slit that is narrower than a pixel is wrong by up to 0.1."""


@final
class MeshSilhouette(MaskSource):
    """The share of each pixel that the mesh covers (`contour`). What stands before the object is not masked."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask (H, W) for each view with a camera; `StageError` without a mesh."""
        if scene is None:
            raise StageError(
                "the mask source 'mesh_silhouette' needs a mesh; start from a scan: --set "
                "'initializers=[\"mesh_file\"]' --set initializer.mesh_file.path=FILE"
            )
        import torch

        from hir_plugins.geometry_renderers.contour import Contour
        from hir_plugins.geometry_renderers.options import ContourOptions

        renderer, mesh, found = (
            Contour(ContourOptions(render_lines=LINES_PER_PIXEL)),
            scene.mesh,
            list[NDArray[np.float32] | None](),
        )
        with torch.no_grad():
            for view in capture.views:
                image = None if view.camera is None else renderer.render(mesh, [view.camera])[0]
                found.append(None if image is None else image.cpu().numpy().astype(np.float32))
        return found
