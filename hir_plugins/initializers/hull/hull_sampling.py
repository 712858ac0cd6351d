"""The visual hull, sampled on a grid: coarsely everywhere, finely near its surface."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Array
from hir_plugins.initializers.hull.hull_field import CHUNK_POINTS, HullField
from hir_plugins.initializers.hull.inconsistent_masks import without_inconsistent_masks
from hir_plugins.initializers.hull.object_box import FIELD_SLOPE, empty_hull_error, object_box
from hir_plugins.initializers.surface.volume import Volume


def sample_hull(field: HullField, voxel_pixels: float, max_resolution: int, drop_bad_views: bool) -> Volume:
    """The hull's field in a box around the object, in world units; the outermost layer of voxels is outside.

    `voxel_pixels` is the side of a voxel in pixels at the object, `max_resolution` the largest number of voxels along a
    side. The fine grid is evaluated only where the coarse one comes near the surface.
    """
    low, high, _ = object_box(field)
    if drop_bad_views:
        field, low, high = without_inconsistent_masks(field, low, high)
    extent = float((high - low).max())
    fine = max(voxel_pixels * field.pixel, extent / max_resolution)
    ratio = max(2, min(6, round(extent / fine / 48)))
    coarse = fine * ratio
    size = np.ceil((high - low) / coarse).astype(int) + 2
    origin = (low + high) / 2 - size * coarse / 2
    centres = _grid(origin + coarse / 2, coarse, size)
    reach = np.sqrt(3) / 2 * coarse * FIELD_SLOPE + fine
    rough = field.field(centres, cut=2 * reach).reshape(*size)
    dense = rough
    for axis in range(3):
        dense = dense.repeat_interleave(ratio, dim=axis)
    active = (rough.abs() <= reach).nonzero()
    offsets = _grid(np.zeros(3), 1.0, np.array([ratio] * 3)).long()
    for part in active.split(max(1, CHUNK_POINTS // ratio**3)):
        where = (part[:, None] * ratio + offsets[None]).reshape(-1, 3)
        points = torch.from_numpy(origin + fine / 2).float() + where.float() * fine
        dense[where[:, 0], where[:, 1], where[:, 2]] = field.field(points, cut=4 * fine)
    values_np = dense.numpy()
    for axis in range(3):
        side = np.moveaxis(values_np, axis, 0)
        side[[0, -1]] = np.minimum(side[[0, -1]], -fine)
    if not (values_np > 0).any():
        raise empty_hull_error()
    # only the sign matters far from the surface; a bound keeps the interpolation finite
    values_np = np.clip(values_np, -4 * fine, 4 * fine)
    return Volume(
        values=np.ascontiguousarray(values_np * field.radius, dtype=np.float32),
        origin=field.center + (origin + fine / 2) * field.radius,
        spacing=fine * field.radius,
    )


def _grid(first: Array, spacing: float, size: NDArray[np.int_]) -> Tensor:
    axes = [torch.from_numpy(first[i] + np.arange(size[i]) * spacing).float() for i in range(3)]
    return torch.cartesian_prod(*axes)
