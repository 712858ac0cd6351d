"""Masks that contradict nearly all others; the hull is carved without them."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Array
from hir_plugins.initializers.hull.hull_field import HullField
from hir_plugins.initializers.hull.object_box import BOX_RESOLUTION, object_box

_MIN_VIEWS_FOR_LONE_TEST = 20
"""Photographs among which one that stands alone is wrong, and not the only one that looks into a gap."""


_MAX_LONE_CUT_SHARE = 0.02
"""Share of the object's volume that no right mask cuts away alone."""


def without_inconsistent_masks(carver: HullField, low: Array, high: Array) -> tuple[HullField, Array, Array]:
    """Drops views, at most a tenth, whose mask does not fit what nearly all others keep."""
    count = len(carver.fields)
    allowed = count // 10
    if count < 8 or allowed == 0:
        return carver, low, high
    bad = _contradicting_masks(carver, allowed) | _lone_cutting_masks(carver)
    if not bad.any():
        return carver, low, high
    names = [f.name for f, b in zip(carver.fields, bad, strict=True) if b]
    if bad.sum() > allowed:
        warnings.warn(
            f"{len(names)} of {count} masks contradict most of the others, such as {names[0]}: "
            "cameras and masks do not agree well",
            stacklevel=4,
        )
        return carver, low, high
    warnings.warn(
        f"the masks of {', '.join(names)} contradict nearly all others; they are left out of the hull", stacklevel=4
    )
    better = carver.without(bad)
    low, high, _ = object_box(better)
    return better, low, high


def _contradicting_masks(carver: HullField, tolerated: int) -> NDArray[np.bool_]:
    """Views whose mask cuts away a third of what the others keep, or shows besides what they do not."""
    kept, spacing = _tolerant_hull_points(carver, tolerated)
    if len(kept) < 20:
        return np.zeros(len(carver.fields), dtype=bool)
    cut = (carver.per_view(kept) < -spacing / 2).float().mean(dim=1).numpy()
    # a right mask may be the only one that looks into a gap: a wrong one cuts very much, or shows what is not there
    return np.array(
        [
            share > 1 / 3 or (share > 0.1 and carver.unexplained(view, kept, spacing) > 0.1)
            for view, share in enumerate(cut)
        ]
    )


def _lone_cutting_masks(carver: HullField) -> NDArray[np.bool_]:
    """Views whose mask alone cuts away a piece: beside them hardly any mask cuts what all but a twentieth keep.

    Only among many photographs, where a gap that one of them looks into is seen by its neighbours too.
    """
    count = len(carver.fields)
    if count < _MIN_VIEWS_FOR_LONE_TEST:
        return np.zeros(count, dtype=bool)
    kept, spacing = _tolerant_hull_points(carver, count // _MIN_VIEWS_FOR_LONE_TEST)
    if len(kept) < 20:
        return np.zeros(count, dtype=bool)
    cut = (carver.per_view(kept) < -spacing / 2).float().mean(dim=1).numpy()
    return np.asarray((cut > _MAX_LONE_CUT_SHARE) & (cut > 10 * np.quantile(cut, 0.9)))


def _tolerant_hull_points(carver: HullField, tolerated: int) -> tuple[Tensor, float]:
    """Points (N, 3) of the hull that forgives some masks, and the largest side of their cells; unit frame."""
    tolerant = carver.without(np.zeros(len(carver.fields), dtype=bool))
    tolerant.tolerated = max(carver.tolerated, tolerated)
    low, high, _ = object_box(tolerant)
    cell = (high - low) / BOX_RESOLUTION
    points = torch.cartesian_prod(
        *[torch.from_numpy(low[i] + (np.arange(BOX_RESOLUTION) + 0.5) * cell[i]).float() for i in range(3)]
    )
    return points[tolerant.field(points) > 0], float(cell.max())
