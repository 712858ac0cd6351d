"""Visual hulls for cross-validation: for each fold of the views, the hull of the others' masks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Array
from hir_plugins.initializers.hull.hull_field import CHUNK_POINTS, HullField
from hir_plugins.initializers.hull.object_box import FIELD_SLOPE, empty_hull_error, object_box
from hir_plugins.initializers.surface.isosurface import Faces, extract_surface
from hir_plugins.initializers.surface.silhouette_fields import SilhouetteField
from hir_plugins.initializers.surface.volume import Volume

FOLDS = 4
"""A view is compared with the hull of three quarters of the views, its own not among them."""
_TOLERATED_SHARE = 0.04
"""A point is carved away where more than this share of the masks show background there. Masks that lie wrong by
chance carve too much: with some tolerated, the error of the hull's outline is near zero in the mean."""
_COARSE, _RATIO = 32, 3
"""Cells along a side of the box, and fine cells along a coarse one."""
_MARGIN = 0.1
"""Of the box, on each side: it is made once, and the hull moves."""


@dataclass(frozen=True)
class HullBox:
    """The cube in which hulls are sampled, in world units."""

    low: Array
    """(3,)"""
    side: float


def fold_of_views(views: int) -> NDArray[np.int64]:
    """The number of each view's fold (V,); neighbours are in different ones."""
    return np.arange(views) % min(FOLDS, views)


def hull_box(fields: Sequence[SilhouetteField]) -> HullBox:
    """A cube around the hull of all masks, with a margin; `CaptureError` where no point is in all of them."""
    field = HullField(fields, _tolerated(len(fields)), 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what the masks leave open is for the initializer of the surface
        low, high, _ = object_box(field)
    side = (1 + 2 * _MARGIN) * float((high - low).max()) * field.radius
    return HullBox(field.center + field.radius * (low + high) / 2 - side / 2, side)


def hulls_of_others(fields: Sequence[SilhouetteField], box: HullBox) -> list[tuple[Array, Faces]]:
    """For each fold the surface of the hull of all other views' masks."""
    fold = fold_of_views(len(fields))
    return hulls_of(fields, [np.flatnonzero(fold != each) for each in range(int(fold.max()) + 1)], box)


def hulls_of(
    fields: Sequence[SilhouetteField], chosen: Sequence[NDArray[np.int64]], box: HullBox
) -> list[tuple[Array, Faces]]:
    """For each list of indices the surface of the hull of these views' masks; `CaptureError` for an empty hull."""
    field = HullField(fields, 0, 2)
    views = [torch.from_numpy(each) for each in chosen]
    low, side = (box.low - field.center) / field.radius, box.side / field.radius
    cell = side / _COARSE
    rough = _consensus(field, _grid(low + cell / 2, cell, _COARSE), views).reshape(len(views), *[_COARSE] * 3)
    reach = np.sqrt(3) / 2 * cell * FIELD_SLOPE + cell / _RATIO
    dense = rough
    for axis in (1, 2, 3):
        dense = dense.repeat_interleave(_RATIO, dim=axis)
    active = (rough.abs() <= reach).any(dim=0).nonzero()
    offsets = torch.cartesian_prod(*[torch.arange(_RATIO)] * 3)
    where = (active[:, None] * _RATIO + offsets[None]).reshape(-1, 3)
    fine = cell / _RATIO
    points = torch.from_numpy(low + fine / 2).float() + where.float() * fine
    dense[:, where[:, 0], where[:, 1], where[:, 2]] = _consensus(field, points, views)
    if not bool((dense > 0).flatten(1).any(dim=1).all()):
        raise empty_hull_error()
    origin, spacing = box.low + fine * field.radius / 2, fine * field.radius
    return [extract_surface(Volume(_closed(each, fine), origin, spacing)) for each in dense.numpy()]


def _consensus(field: HullField, points: Tensor, chosen: Sequence[Tensor]) -> Tensor:
    """For each list of views (F) the lowest of their signed distances (F, N) that is not tolerated."""
    parts = []
    for chunk in points.split(CHUNK_POINTS // 4):
        values = field.per_view(chunk)
        # a point outside an image is not carved by it; outside of half of them it is background
        unseen = torch.isinf(values)
        parts.append(
            torch.stack(
                [
                    torch.where(
                        unseen[own].sum(dim=0) * 2 > len(own),
                        -1.0,
                        values[own].kthvalue(1 + _tolerated(len(own)), dim=0).values,
                    )
                    for own in chosen
                ]
            )
        )
    return torch.cat(parts, dim=1)


def _tolerated(views: int) -> int:
    return int(_TOLERATED_SHARE * views)


def _closed(values: NDArray[np.float32], spacing: float) -> NDArray[np.float32]:
    """The field with its border outside, clipped near the surface so that interpolation stays finite."""
    clipped = np.clip(values, -4 * spacing, 4 * spacing)
    for axis in range(3):
        side = np.moveaxis(clipped, axis, 0)
        side[[0, -1]] = np.minimum(side[[0, -1]], -spacing)
    return np.ascontiguousarray(clipped)


def _grid(first: Array, spacing: float, size: int) -> Tensor:
    axes = [torch.from_numpy(first[i] + np.arange(size) * spacing).float() for i in range(3)]
    return torch.cartesian_prod(*axes)
