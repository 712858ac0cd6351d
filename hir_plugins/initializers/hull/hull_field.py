"""The visual hull as a field: at each point the least of the masks' signed distances (Laurentini 1994)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Array
from hir_plugins.initializers.surface.silhouette_fields import SilhouetteField, focus_and_radius

CHUNK_POINTS = 1 << 17
_UNSEEN_DISTANCE = -1e6
_VIEW_BATCH = 8
"""Number of views that are sampled before points far outside are removed from the batch."""


class HullField:
    """The hull's field, in a unit frame around the object: results do not depend on the scale of the world."""

    def __init__(self, fields: Sequence[SilhouetteField], tolerated: int, min_views: int) -> None:
        self.fields = list(fields)
        self.center, self.radius = focus_and_radius(self.fields)
        self.tolerated = tolerated
        world_from_unit = np.diag([self.radius] * 3 + [1.0])
        world_from_unit[:3, 3] = self.center
        self._views = [_view_tensors(f, world_from_unit) for f in self.fields]
        self.min_views = min_views or self._enough_views()

    def _enough_views(self) -> int:
        """Half of the largest number of photographs that show any point of the hull.

        Behind the object, in few photographs, the cones of neighbouring masks overlap and no other mask carves there.
        """
        self.min_views = 2
        axis = torch.linspace(-1.0, 1.0, 32)
        points = torch.cartesian_prod(axis, axis, axis)
        inside = self.field(points) > -float(axis[1] - axis[0])
        if not inside.any():
            return 2
        view_count = torch.isfinite(self.per_view(points[inside])).sum(dim=0)
        return max(2, (int(view_count.max()) + 1) // 2)

    def without(self, bad: NDArray[np.bool_]) -> HullField:
        """A field in the same frame without the views marked in `bad` (V,)."""
        reduced = HullField.__new__(HullField)
        reduced.__dict__.update(self.__dict__)
        reduced.fields = [f for f, b in zip(self.fields, bad, strict=True) if not b]
        reduced._views = [v for v, b in zip(self._views, bad, strict=True) if not b]
        reduced.min_views = min(self.min_views, len(reduced.fields))
        return reduced

    @property
    def pixel(self) -> float:
        """Size of a pixel at the focus, median over the views, in units of the radius."""
        sizes = []
        for field in self.fields:
            depth = float(np.linalg.norm(field.camera.center - self.center))
            sizes.append(depth / field.camera.focal_length)
        return float(np.median(sizes)) / self.radius

    def per_view(self, points: Tensor) -> Tensor:
        """Each view's signed distance (V, N) at unit-frame points (N, 3); +inf outside the view's image."""
        axes = points.T.contiguous()
        return torch.stack([_sample(view, axes) for view in self._views])

    def unexplained(self, view: int, points: Tensor, spacing: float) -> float:
        """Share of a view's mask that no sphere of radius `spacing` around unit-frame points (N, 3) covers."""
        from scipy.spatial import cKDTree

        local = points @ self._views[view].projection[:, :3].T + self._views[view].projection[:, 3]
        local = local[local[:, 2] > 1e-6]
        mask = np.argwhere(self.fields[view].distance > 1)
        if not len(local) or not len(mask):
            return 1.0
        mask = mask[:: max(1, len(mask) // 2000)]
        nearest, which = cKDTree((local[:, :2] / local[:, 2:]).numpy()).query(mask[:, ::-1] + 0.5)
        reach = spacing * self._views[view].focal / local[:, 2].numpy()[which]
        return float((nearest > reach).mean())

    def field(self, points: Tensor, cut: float = np.inf) -> Tensor:
        """The hull's field (N,) at unit-frame points (N, 3); exact above -cut, an upper bound of it below."""
        return torch.cat([self._field(chunk, cut) for chunk in points.split(CHUNK_POINTS)])

    def _field(self, points: Tensor, cut: float) -> Tensor:
        keep = self.tolerated + 1
        # the cost of merging grows with `keep`: a batch of at least as many views keeps it linear in the views
        batch = max(_VIEW_BATCH, keep)
        result = points.new_full((len(points),), _UNSEEN_DISTANCE)
        axes, index = points.T.contiguous(), torch.arange(len(points))
        lowest = points.new_full((len(points), keep), torch.inf)
        seen = torch.zeros(len(points), dtype=torch.int64)
        for start in range(0, len(self._views), batch):
            values = torch.stack([_sample(view, axes) for view in self._views[start : start + batch]], dim=1)
            seen += torch.isfinite(values).sum(dim=1)
            lowest = _lowest(torch.cat([lowest, values], dim=1), keep)
            if np.isfinite(cut):
                alive = lowest[:, -1] > -cut
                if alive.float().mean() < 0.8:
                    result[index[~alive]] = lowest[~alive, -1]
                    axes, index, lowest, seen = axes[:, alive], index[alive], lowest[alive], seen[alive]
        known = seen >= self.min_views
        result[index[known]] = lowest[known, -1].clamp_max(-_UNSEEN_DISTANCE)
        return result


def _lowest(values: Tensor, keep: int) -> Tensor:
    """The `keep` lowest of each row (N, M), the highest of them last."""
    if keep == 1:
        return values.amin(dim=1, keepdim=True)
    return torch.from_numpy(np.partition(values.numpy(), keep - 1, axis=1)[:, :keep].copy())


@dataclass(frozen=True)
class _ViewTensors:
    projection: Tensor
    """3×4, from the unit frame to pixels times depth; depth in units of the radius."""
    distance: Tensor
    """1 1 H W, float16."""
    focal: float


def _view_tensors(field: SilhouetteField, world_from_unit: Array) -> _ViewTensors:
    # composed in float64, without the world's position and scale, before the conversion to float32
    pose = field.camera.world_to_camera @ world_from_unit
    projection = field.camera.intrinsics @ pose[:3] / world_from_unit[0, 0]
    return _ViewTensors(
        torch.from_numpy(projection).float(), torch.from_numpy(field.distance)[None, None], field.camera.focal_length
    )


def _sample(view: _ViewTensors, axes: Tensor) -> Tensor:
    """Signed distance (N,) across the viewing ray in units of the radius; +inf where the picture does not reach.

    `axes` (3, N): each coordinate of the points is an array of its own, which is twice as fast.
    """
    height, width = view.distance.shape[2:]
    x, y, depth = torch.addmm(view.projection[:, 3:], view.projection[:, :3], axes)
    shrunk = depth.clamp_min(1e-6)
    column, row = x / shrunk * (2 / width) - 1, y / shrunk * (2 / height) - 1
    visible = (depth > 1e-6) & (column.abs() <= 1) & (row.abs() <= 1)
    sampled = torch.nn.functional.grid_sample(
        view.distance.float(),
        torch.stack([column, row], dim=1)[None, None].clamp(-2, 2),
        padding_mode="border",
        align_corners=False,
    )[0, 0, 0]
    return torch.where(visible, sampled * depth / view.focal, torch.inf)
