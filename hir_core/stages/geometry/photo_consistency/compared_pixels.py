"""Which pixels are compared: not those whose window contains two surfaces.

Beside an occlusion boundary the window of the detail shows the surface in front and the one behind. Their places
differ from view to view, so that views agree about a wrong surface. On a vessel without texture the rim in front of the
inside is most of what there is to compare.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.mesh.ray_casting import MeshQueries
from hir_core.stages.geometry.depth_jumps import beside_jumps, depth_map
from hir_core.stages.geometry.photo_consistency.detail_images import DetailImages, of_each_view, whole_squares

SEPARATE_SURFACES_PIXELS: Final = 20.0
"""Depth between two surfaces, in widths of a pixel, from which a window that contains both is left out. Windows over
smaller steps do no harm (docs/studies/photo_consistency.md#beside-occlusion-boundaries)."""

MARGIN_PIXELS: Final = 5
"""Beyond it 2 % of a window (two boxes of `WINDOW_PIXELS`) lie on the other side of the boundary."""


def away_from_occlusion_boundaries(details: DetailImages, tracer: MeshQueries) -> DetailImages:
    """The same images without the pixels beside occlusion boundaries of the mesh of `tracer`: they are neither drawn
    nor looked up. Outlines are left as they are, because windows there leave out what is beyond the mask.
    """
    square_inside = details.square_inside.clone()

    def of_view(view: int) -> NDArray[np.int32]:
        camera = details.cameras[view]
        inside = np.zeros((camera.height, camera.width), bool)
        x, y = details.pixels[view].T
        inside[y, x] = True
        depth = depth_map(tracer, camera, inside, 1)
        pixel_angle = 1 / camera.focal_length
        inside &= ~beside_jumps(depth, pixel_angle, MARGIN_PIXELS, SEPARATE_SURFACES_PIXELS, outlines=False)
        squares = whole_squares(torch.from_numpy(inside)).to(square_inside.device)
        square_inside[view, : camera.height - 1, : camera.width - 1] &= squares
        return np.argwhere(inside)[:, ::-1].astype(np.int32)

    pixels = of_each_view(of_view, len(details.cameras))
    return replace(details, square_inside=square_inside, pixels=tuple(pixels))
