"""A contact sheet of all photographs."""

from __future__ import annotations

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.intake.reduced_pictures import reduce_to_side


def contact_sheet(capture: Capture, columns: int = 8, side: int = 160) -> NDArray[np.uint8]:
    """An image (H, W, 3) of all photographs in a grid; pixels outside the masks are dimmed."""
    rows = -(-len(capture.views) // columns)
    sheet = np.full((max(rows, 1) * side, columns * side, 3), 24, np.uint8)
    for i, view in enumerate(capture.views):
        pixels, _ = reduce_to_side(view, view.pixels(), side)
        thumbnail = linear_to_srgb(np.clip(pixels.color_linear, 0, 1))
        if pixels.mask is not None:
            thumbnail = thumbnail * (0.25 + 0.75 * pixels.mask[..., None])
        height, width = min(thumbnail.shape[0], side), min(thumbnail.shape[1], side)
        top, left = (i // columns) * side, (i % columns) * side
        sheet[top : top + height, left : left + width] = np.rint(thumbnail[:height, :width] * 255)
    return sheet
