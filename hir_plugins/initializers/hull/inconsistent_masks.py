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
"""Number of photographs from which a gap is visible in several of them, so that a lone mask is wrong."""
_MAX_LONE_CUT_SHARE = 0.02
"""Largest share of the object's volume that a correct mask carves alone."""


def without_inconsistent_masks(field: HullField, low: Array, high: Array) -> tuple[HullField, Array, Array]:
    """The field without views whose masks contradict nearly all others, at most a tenth of them, and its box.

    A warning names the views. If more masks contradict each other, all of them are used and a warning reports it.
    """
    count = len(field.fields)
    allowed = count // 10
    if count < 8 or allowed == 0:
        return field, low, high
    bad = _contradicting_masks(field, allowed) | _lone_cutting_masks(field)
    if not bad.any():
        return field, low, high
    names = [f.name for f, b in zip(field.fields, bad, strict=True) if b]
    if bad.sum() > allowed:
        warnings.warn(
            f"{len(names)} of {count} masks contradict most of the others, such as {names[0]}: "
            "cameras and masks do not agree well; hir check shows which",
            stacklevel=4,
        )
        return field, low, high
    warnings.warn(
        f"the masks of {', '.join(names)} contradict nearly all others; they are left out of the hull", stacklevel=4
    )
    reduced = field.without(bad)
    low, high, _ = object_box(reduced)
    return reduced, low, high


def _contradicting_masks(field: HullField, tolerated: int) -> NDArray[np.bool_]:
    """Views whose mask carves a third of the hull of the others, or a tenth and has content outside that hull."""
    points, spacing = _tolerant_hull_points(field, tolerated)
    if len(points) < 20:
        return np.zeros(len(field.fields), dtype=bool)
    cut = (field.per_view(points) < -spacing / 2).float().mean(dim=1).numpy()
    # a correct mask may be the only one that shows a gap; a wrong one carves far more, or covers pixels beside the hull
    return np.array(
        [
            share > 1 / 3 or (share > 0.1 and field.unexplained(view, points, spacing) > 0.1)
            for view, share in enumerate(cut)
        ]
    )


def _lone_cutting_masks(field: HullField) -> NDArray[np.bool_]:
    """Views whose mask alone carves a part of the hull that tolerates a twentieth of the masks.

    Tested only among many photographs, where a real gap is visible in several neighbouring ones.
    """
    count = len(field.fields)
    if count < _MIN_VIEWS_FOR_LONE_TEST:
        return np.zeros(count, dtype=bool)
    points, spacing = _tolerant_hull_points(field, count // _MIN_VIEWS_FOR_LONE_TEST)
    if len(points) < 20:
        return np.zeros(count, dtype=bool)
    cut = (field.per_view(points) < -spacing / 2).float().mean(dim=1).numpy()
    return np.asarray((cut > _MAX_LONE_CUT_SHARE) & (cut > 10 * np.quantile(cut, 0.9)))


def _tolerant_hull_points(field: HullField, tolerated: int) -> tuple[Tensor, float]:
    """Points (N, 3) of the hull that tolerates some masks, and the largest side of their cells; unit frame."""
    tolerant = field.without(np.zeros(len(field.fields), dtype=bool))
    tolerant.tolerated = max(field.tolerated, tolerated)
    low, high, _ = object_box(tolerant)
    cell = (high - low) / BOX_RESOLUTION
    points = torch.cartesian_prod(
        *[torch.from_numpy(low[i] + (np.arange(BOX_RESOLUTION) + 0.5) * cell[i]).float() for i in range(3)]
    )
    return points[tolerant.field(points) > 0], float(cell.max())
