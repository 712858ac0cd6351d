"""The visual hull as a field: at each place the least of the masks' signed distances (Laurentini 1994)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Array
from hir_core.errors import CaptureError
from hir_plugins.initializers.surface.silhouette_fields import SilhouetteField, focus_and_radius
from hir_plugins.initializers.surface.volume import Volume

_CHUNK = 1 << 17
_SLACK = 1.3
"""How much faster than distance the field may change: rays at the edge of a wide picture, and depth."""
_BOX_RESOLUTION = 40
_MAX_GROWTH = 5
_UNSEEN = -1e6
_TOGETHER = 8
"""Views that are sampled before places far outside are let go."""
_MANY_VIEWS = 20
"""Photographs among which one that stands alone is wrong, and not the only one that looks into a gap."""
_PIECE = 0.02
"""Share of the object's volume that no right mask cuts away alone."""


class Carver:
    """Evaluates the hull's field; works in a frame of the object's size, so that any scale of the world will do."""

    def __init__(self, fields: Sequence[SilhouetteField], tolerated: int, min_views: int) -> None:
        self.fields = list(fields)
        self.center, self.radius = focus_and_radius(self.fields)
        self.tolerated = tolerated
        world_from_unit = np.diag([self.radius] * 3 + [1.0])
        world_from_unit[:3, 3] = self.center
        self._views = [_view_tensors(f, world_from_unit) for f in self.fields]
        self.min_views = min_views or self._enough_views()

    def _enough_views(self) -> int:
        """Half of the photographs that show the best seen place of the hull.

        Behind the object, where few cameras look, cones of neighbours overlap and no mask says otherwise.
        """
        self.min_views = 2
        axis = torch.linspace(-1.0, 1.0, 32)
        points = torch.cartesian_prod(axis, axis, axis)
        inside = self.field(points) > -float(axis[1] - axis[0])
        if not inside.any():
            return 2
        shown = torch.isfinite(self.per_view(points[inside])).sum(dim=0)
        return max(2, (int(shown.max()) + 1) // 2)

    def without(self, bad: NDArray[np.bool_]) -> Carver:
        """The same frame with some views left out."""
        left = Carver.__new__(Carver)
        left.__dict__.update(self.__dict__)
        left.fields = [f for f, b in zip(self.fields, bad, strict=True) if not b]
        left._views = [v for v, b in zip(self._views, bad, strict=True) if not b]
        left.min_views = min(self.min_views, len(left.fields))
        return left

    @property
    def pixel(self) -> float:
        """Side of a pixel at the focus, median over the views, in units of the radius."""
        sizes = []
        for field in self.fields:
            depth = float(np.linalg.norm(field.camera.center - self.center))
            sizes.append(depth / float(np.sqrt(abs(np.linalg.det(field.camera.intrinsics[:2, :2])))))
        return float(np.median(sizes)) / self.radius

    def per_view(self, points: Tensor) -> Tensor:
        """Each view's signed distance (V, N) at unit-frame points (N, 3); +inf where the view does not show it."""
        return torch.stack([_sample(view, points) for view in self._views])

    def unexplained(self, view: int, points: Tensor, spacing: float) -> float:
        """Share of a view's mask that no ball of radius `spacing` around unit-frame points (N, 3) covers."""
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
        """The hull's field (N,) at unit-frame points (N, 3); exact above -cut, below it only surely negative."""
        return torch.cat([self._field(chunk, cut) for chunk in points.split(_CHUNK)])

    def _field(self, points: Tensor, cut: float) -> Tensor:
        keep = self.tolerated + 1
        # as many views at a time as are kept: one by one, thirty that are kept would make it quadratic in the views
        together = max(_TOGETHER, keep)
        result = points.new_full((len(points),), _UNSEEN)
        index = torch.arange(len(points))
        lowest = points.new_full((len(points), keep), torch.inf)
        seen = torch.zeros(len(points), dtype=torch.int64)
        for start in range(0, len(self._views), together):
            values = torch.stack([_sample(view, points) for view in self._views[start : start + together]], dim=1)
            seen += torch.isfinite(values).sum(dim=1)
            lowest = _lowest(torch.cat([lowest, values], dim=1), keep)
            if np.isfinite(cut):
                alive = lowest[:, -1] > -cut
                if alive.float().mean() < 0.8:
                    result[index[~alive]] = lowest[~alive, -1]
                    points, index, lowest, seen = points[alive], index[alive], lowest[alive], seen[alive]
        known = seen >= self.min_views
        result[index[known]] = lowest[known, -1].clamp_max(-_UNSEEN)
        return result


def carve(carver: Carver, voxel_pixels: float, max_resolution: int, drop_bad_views: bool) -> Volume:
    """Finds the object's box, then samples the hull: everywhere on a coarse grid, finely where the surface is.

    The volume is in world units; its outermost layer is outside.
    """
    low, high, _ = _search_box(carver)
    if drop_bad_views:
        carver, low, high = _without_bad_views(carver, low, high)
    extent = float((high - low).max())
    fine = max(voxel_pixels * carver.pixel, extent / max_resolution)
    ratio = max(2, min(6, round(extent / fine / 48)))
    coarse = fine * ratio
    size = np.ceil((high - low) / coarse).astype(int) + 2
    origin = (low + high) / 2 - size * coarse / 2
    centres = _grid(origin + coarse / 2, coarse, size)
    reach = np.sqrt(3) / 2 * coarse * _SLACK + fine
    rough = carver.field(centres, cut=2 * reach).reshape(*size)
    dense = rough
    for axis in range(3):
        dense = dense.repeat_interleave(ratio, dim=axis)
    active = (rough.abs() <= reach).nonzero()
    offsets = _grid(np.zeros(3), 1.0, np.array([ratio] * 3)).long()
    for part in active.split(max(1, _CHUNK // ratio**3)):
        where = (part[:, None] * ratio + offsets[None]).reshape(-1, 3)
        points = torch.from_numpy(origin + fine / 2).float() + where.float() * fine
        dense[where[:, 0], where[:, 1], where[:, 2]] = carver.field(points, cut=4 * fine)
    values_np = dense.numpy()
    for axis in range(3):
        side = np.moveaxis(values_np, axis, 0)
        side[[0, -1]] = np.minimum(side[[0, -1]], -fine)
    if not (values_np > 0).any():
        raise _disagreement()
    # the sign is all that counts far from the surface; a bound keeps the interpolation finite
    values_np = np.clip(values_np, -4 * fine, 4 * fine)
    return Volume(
        values=np.ascontiguousarray(values_np * carver.radius, dtype=np.float32),
        origin=carver.center + (origin + fine / 2) * carver.radius,
        spacing=fine * carver.radius,
    )


def _search_box(carver: Carver) -> tuple[Array, Array, Tensor]:
    """Corners of a box around what is inside the hull, in the unit frame; grown until nothing touches its sides."""
    low, high = -1.2 * np.ones(3), 1.2 * np.ones(3)
    for growth in range(_MAX_GROWTH + 1):
        cell = (high - low) / _BOX_RESOLUTION
        axes = [torch.from_numpy(low[i] + (np.arange(_BOX_RESOLUTION) + 0.5) * cell[i]).float() for i in range(3)]
        points = torch.cartesian_prod(*axes)
        values = carver.field(points)
        # a thin object may fall between the samples: whatever comes within half a cell's diagonal may be inside
        near = (values > -float(np.linalg.norm(cell)) / 2 * _SLACK).reshape(*[_BOX_RESOLUTION] * 3)
        if not near.any():
            raise _disagreement()
        grown = False
        new_low, new_high = low.copy(), high.copy()
        for axis in range(3):
            used = near.any(dim=(axis + 1) % 3, keepdim=True).any(dim=(axis + 2) % 3, keepdim=True).flatten().nonzero()
            first, last = int(used.min()), int(used.max())
            # zooming in and growing in one: a side that is touched moves out, the others close in
            for touched, side in ((first == 0, "low"), (last == _BOX_RESOLUTION - 1, "high")):
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
                    new_high[axis] = low[axis] + min(last + 2, _BOX_RESOLUTION) * cell[axis]
        shrunk = ((new_high - new_low) < 0.7 * (high - low)).any()
        low, high = new_low, new_high
        if not grown and not shrunk:
            return low, high, values
    if grown:
        warnings.warn(
            "the masks leave the object's extent open on some side; the hull is cut there. Add photographs "
            "from other sides",
            stacklevel=3,
        )
    return low, high, values


def _without_bad_views(carver: Carver, low: Array, high: Array) -> tuple[Carver, Array, Array]:
    """Drops views, at most a tenth, whose mask does not fit what nearly all others keep."""
    count = len(carver.fields)
    allowed = count // 10
    if count < 8 or allowed == 0:
        return carver, low, high
    bad = _contradicting(carver, allowed) | _alone(carver)
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
    low, high, _ = _search_box(better)
    return better, low, high


def _contradicting(carver: Carver, tolerated: int) -> NDArray[np.bool_]:
    """Views whose mask cuts away a third of what the others keep, or shows besides what they do not."""
    kept, spacing = _tolerant_body(carver, tolerated)
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


def _alone(carver: Carver) -> NDArray[np.bool_]:
    """Views whose mask alone cuts away a piece: beside them hardly any mask cuts what all but a twentieth keep.

    Only among many photographs, where a gap that one of them looks into is seen by its neighbours too.
    """
    count = len(carver.fields)
    if count < _MANY_VIEWS:
        return np.zeros(count, dtype=bool)
    kept, spacing = _tolerant_body(carver, count // _MANY_VIEWS)
    if len(kept) < 20:
        return np.zeros(count, dtype=bool)
    cut = (carver.per_view(kept) < -spacing / 2).float().mean(dim=1).numpy()
    return np.asarray((cut > _PIECE) & (cut > 10 * np.quantile(cut, 0.9)))


def _tolerant_body(carver: Carver, tolerated: int) -> tuple[Tensor, float]:
    """Points (N, 3) of the hull that forgives some masks, and the largest side of their cells; unit frame."""
    tolerant = carver.without(np.zeros(len(carver.fields), dtype=bool))
    tolerant.tolerated = max(carver.tolerated, tolerated)
    low, high, _ = _search_box(tolerant)
    cell = (high - low) / _BOX_RESOLUTION
    points = torch.cartesian_prod(
        *[torch.from_numpy(low[i] + (np.arange(_BOX_RESOLUTION) + 0.5) * cell[i]).float() for i in range(3)]
    )
    return points[tolerant.field(points) > 0], float(cell.max())


def _disagreement() -> CaptureError:
    return CaptureError(
        "no place lies inside all masks: cameras and masks do not agree. Check that masks are white on the object, and "
        "the cameras' axes; initializer.visual_hull.tolerated_views forgives a few bad ones"
    )


def _lowest(values: Tensor, keep: int) -> Tensor:
    """The `keep` lowest of each row (N, M), the highest of them last."""
    if keep == 1:
        return values.amin(dim=1, keepdim=True)
    return torch.from_numpy(np.partition(values.numpy(), keep - 1, axis=1)[:, :keep].copy())


def _grid(first: Array, spacing: float, size: NDArray[np.int_]) -> Tensor:
    axes = [torch.from_numpy(first[i] + np.arange(size[i]) * spacing).float() for i in range(3)]
    return torch.cartesian_prod(*axes)


@dataclass(frozen=True)
class _ViewTensors:
    projection: Tensor
    """3×4, from the unit frame to pixels times depth; depth in units of the radius."""
    distance: Tensor
    """1 1 H W, float16."""
    focal: float


def _view_tensors(field: SilhouetteField, world_from_unit: Array) -> _ViewTensors:
    # composed in float64 and freed of the world's place and scale before it becomes float32
    pose = field.camera.world_to_camera @ world_from_unit
    projection = field.camera.intrinsics @ pose[:3] / world_from_unit[0, 0]
    focal = float(np.sqrt(abs(np.linalg.det(field.camera.intrinsics[:2, :2]))))
    return _ViewTensors(torch.from_numpy(projection).float(), torch.from_numpy(field.distance)[None, None], focal)


def _sample(view: _ViewTensors, points: Tensor) -> Tensor:
    """Signed distance (N,) across the viewing ray in units of the radius; +inf where the picture does not reach."""
    height, width = view.distance.shape[2:]
    local = points @ view.projection[:, :3].T + view.projection[:, 3]
    depth = local[:, 2]
    pixels = local[:, :2] / depth.clamp_min(1e-6)[:, None]
    scale = torch.tensor([2 / width, 2 / height])
    grid = pixels * scale - 1
    shown = (depth > 1e-6) & (grid.abs() <= 1).all(dim=1)
    sampled = torch.nn.functional.grid_sample(
        view.distance.float(), grid[None, None].clamp(-2, 2), padding_mode="border", align_corners=False
    )[0, 0, 0]
    return torch.where(shown, sampled * depth / view.focal, torch.inf)
