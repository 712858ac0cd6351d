"""A box around the visual hull."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from torch import Tensor

from hir_core.capture import Array
from hir_core.errors import CaptureError
from hir_plugins.initializers.hull.hull_field import HullField

FIELD_SLOPE = 1.3
"""Largest slope of the field: above 1 for rays at the edge of a wide image, and along the depth."""
BOX_RESOLUTION = 40
_MAX_GROWTH = 5


def object_box(field: HullField) -> tuple[Array, Array, Tensor]:
    """Corners (3,) of a box around the hull in the unit frame, and the field's last samples.

    The box grows until the hull touches none of its sides. A hull without any point raises `CaptureError`.
    """
    low, high = -1.2 * np.ones(3), 1.2 * np.ones(3)
    for growth in range(_MAX_GROWTH + 1):
        cell = (high - low) / BOX_RESOLUTION
        axes = [torch.from_numpy(low[i] + (np.arange(BOX_RESOLUTION) + 0.5) * cell[i]).float() for i in range(3)]
        points = torch.cartesian_prod(*axes)
        values = field.field(points)
        # a thin object may fall between the samples: points within half a cell's diagonal may be inside
        near = (values > -float(np.linalg.norm(cell)) / 2 * FIELD_SLOPE).reshape(*[BOX_RESOLUTION] * 3)
        if not near.any():
            raise empty_hull_error()
        grown = False
        new_low, new_high = low.copy(), high.copy()
        for axis in range(3):
            used = near.any(dim=(axis + 1) % 3, keepdim=True).any(dim=(axis + 2) % 3, keepdim=True).flatten().nonzero()
            first, last = int(used.min()), int(used.max())
            # a side that the hull touches moves outwards, the others move inwards
            for touched, side in ((first == 0, "low"), (last == BOX_RESOLUTION - 1, "high")):
                if touched and growth < _MAX_GROWTH:
                    grown = True
                    move = 0.5 * (high[axis] - low[axis])
                    if side == "low":
                        new_low[axis] = low[axis] - move
                    else:
                        new_high[axis] = high[axis] + move
                elif side == "low":
                    new_low[axis] = low[axis] + max(first - 1, 0) * cell[axis]
                else:
                    new_high[axis] = low[axis] + min(last + 2, BOX_RESOLUTION) * cell[axis]
        shrunk = ((new_high - new_low) < 0.7 * (high - low)).any()
        low, high = new_low, new_high
        if not grown and not shrunk:
            return low, high, values
    if grown:
        warnings.warn(
            "the masks do not bound the object on some side, so the hull is cut there; add photographs from other "
            "sides",
            stacklevel=3,
        )
    return low, high, values


def empty_hull_error() -> CaptureError:
    return CaptureError(
        "no point lies inside all masks, so cameras and masks do not agree; check that masks are white on the object, "
        "check the cameras' axes, or raise initializer.visual_hull.tolerated_views for a few wrong masks"
    )
