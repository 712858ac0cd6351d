"""The colour of each vertex as other photographs show it: what a view is predicted from before material and light are
known.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Float16
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.mesh.ray_casting import MeshQueries
from hir_core.scene import Mesh
from hir_core.stages.geometry.depth_jumps import (
    LEAST_JUMP_PIXELS,
    beside_jumps,
    depth_factor,
    depth_map,
)
from hir_core.stages.geometry.occlusion_boundaries.view_photographs import ViewPhotographs
from hir_core.stages.geometry.photo_consistency.photo_residuals import LEAST_COSINE

ANGLE_DEG = 20.0
"""A photograph whose direction is this far from the predicted view's, when the nearest one has the same direction,
weighs 1/e of it."""

LEAST_WEIGHT = 1e-3
"""Sum of weights below which a vertex counts as unseen."""

MARGIN_PIXELS = 2
"""Photographs are not used this near to a depth jump or to the outline: there they may show both sides."""

FILLED_RINGS = 6
"""Unseen vertices take the mean colour of their seen neighbours, so often. The pixels beside a boundary are not used as
colours; these rings bridge them."""

MAX_KEPT_VALUES = 1 << 25
"""Predictions that are kept for later steps, one for each vertex and view: 7 bytes each."""

SMOOTHED_RINGS = 3
"""Of the variance, which few photographs measure at each vertex."""


class VertexColors:
    """sRGB colours of the vertices of a mesh in the named views, and predictions from them."""

    def __init__(
        self,
        mesh: Mesh,
        photographs: ViewPhotographs,
        views: Sequence[int],
        neighbours: Sequence[Sequence[int]],
        tracer: MeshQueries,
    ) -> None:
        """`neighbours` has, for each view, those that it may be predicted from; others than `views` are ignored."""
        self._edges = mesh.topology.edges
        a, b = self._edges.unbind(1)
        self._directed = torch.cat([a, b]), torch.cat([b, a])
        self._column = {view: i for i, view in enumerate(views)}
        self._neighbours = neighbours
        count, device = len(mesh.positions), mesh.positions.device
        self._colors = torch.zeros(count, len(views), 3, dtype=torch.float16, device=device)
        self._weights = torch.zeros(count, len(views), dtype=torch.float16, device=device)
        normals = mesh.normals.detach()
        for view, column in self._column.items():
            colors, weights = _observed(mesh.positions.detach(), normals, photographs, view, tracer)
            self._colors[:, column], self._weights[:, column] = colors.half(), weights.half()
        directions = normalize(photographs.centers, dim=1)
        angle = torch.rad2deg(torch.arccos((directions @ directions.T).clamp(-1, 1)))
        self._angle = angle.float()
        self._predictions: dict[int, tuple[Tensor, Tensor]] = {}

    def predicted(self, views: Sequence[int]) -> tuple[Float[Tensor, "V B 3"], Bool[Tensor, "V B"]]:
        """The colours that each view is expected to show, of photographs of other views, and where they are known."""
        parts = [self._prediction(view) for view in views]
        return torch.stack([part[0] for part in parts], dim=1).float(), torch.stack([part[1] for part in parts], dim=1)

    def _prediction(self, view: int) -> tuple[Float16[Tensor, "V 3"], Bool[Tensor, " V"]]:
        if view not in self._predictions:
            colors, known = self._filled(*self._from_neighbours(view), FILLED_RINGS)
            if len(self._predictions) >= MAX_KEPT_VALUES // max(1, len(colors)):
                return colors.half(), known
            self._predictions[view] = colors.half(), known
        return self._predictions[view]

    def variance(self) -> Float[Tensor, " V"]:
        """Mean squared error of the predictions (sum over the channels) at each vertex and around it, over the views
        that see it; the median of all where none does.
        """
        total = torch.zeros(len(self._colors), device=self._colors.device)
        count = torch.zeros_like(total)
        for view, column in self._column.items():
            colors, known = self._from_neighbours(view)
            seen = known & (self._weights[:, column] > 0)
            total += torch.where(seen, (colors - self._colors[:, column].float()).square().sum(dim=1), 0.0)
            count += seen
        found, known = self._filled((total / count.clamp_min(1))[:, None], count > 0, FILLED_RINGS)
        variance = found[:, 0]
        typical = variance[known].median() if bool(known.any()) else variance.new_zeros(())
        variance = torch.where(known, variance, typical)
        for _ in range(SMOOTHED_RINGS):
            mean, degree = self._sums(torch.stack([variance, torch.ones_like(variance)], dim=1)).unbind(1)
            variance = 0.5 * (variance + mean / degree.clamp_min(1))
        return variance

    def _from_neighbours(self, view: int) -> tuple[Float[Tensor, "V 3"], Bool[Tensor, " V"]]:
        near = [other for other in self._neighbours[view] if other in self._column]
        columns = torch.tensor([self._column[other] for other in near], dtype=torch.long, device=self._colors.device)
        angle = self._angle[view, near].to(self._colors.device)
        # relative to the nearest photograph, however far that is
        similarity = torch.exp((angle.amin() ** 2 - angle**2) / ANGLE_DEG**2) if near else angle
        weights = self._weights.index_select(1, columns).float() * similarity
        total = weights.sum(dim=1)
        colors = (weights[..., None] * self._colors.index_select(1, columns)).sum(dim=1)
        return colors / total.clamp_min(1e-6)[:, None], total > LEAST_WEIGHT

    def _filled(
        self, values: Float[Tensor, "V C"], known: Bool[Tensor, " V"], rings: int
    ) -> tuple[Float[Tensor, "V C"], Bool[Tensor, " V"]]:
        """Only edges from unknown vertices are looked at: fewer from ring to ring."""
        values, known = values.clone(), known.clone()
        to, source = self._directed
        unknown = (~known)[to].nonzero()[:, 0]
        to, source = to[unknown], source[unknown]
        for _ in range(rings):
            used = known[source].nonzero()[:, 0]
            if len(used) == 0:
                break
            reached, place = torch.unique(to[used], return_inverse=True)
            neighbours = torch.cat([values[source[used]], values.new_ones(len(used), 1)], dim=1)
            sums = neighbours.new_zeros(len(reached), neighbours.shape[1]).index_add_(0, place, neighbours)
            values[reached] = sums[:, :-1] / sums[:, -1:]
            known[reached] = True
            left = (~known)[to].nonzero()[:, 0]
            to, source = to[left], source[left]
        return values, known

    def _sums(self, values: Float[Tensor, "V K"]) -> Float[Tensor, "V K"]:
        """Sums over the neighbours of each vertex."""
        a, b = self._edges.unbind(1)
        return torch.zeros_like(values).index_add(0, a, values[b]).index_add(0, b, values[a])


def _observed(
    positions: Float[Tensor, "V 3"],
    normals: Float[Tensor, "V 3"],
    photographs: ViewPhotographs,
    view: int,
    tracer: MeshQueries,
) -> tuple[Float[Tensor, "V 3"], Float[Tensor, " V"]]:
    """Colours of the vertices in one photograph, and the cosine between normal and ray; 0 for those that it does not
    show, or shows beside a depth jump.
    """
    device = positions.device
    to_camera = photographs.centers[view].to(positions) - positions
    distance = to_camera.norm(dim=1)
    cosine = (to_camera * normals).sum(dim=1) / distance.clamp_min(1e-12)
    row = torch.full((len(positions),), view, device=device)
    pixels = photographs.project(positions.double(), row)
    colors, covered = photographs.colors_at(row, pixels)
    angle = photographs.pixel_angle(view)
    camera = photographs.cameras[view]
    factor = depth_factor(camera)
    depth = depth_map(tracer, camera, photographs.inside[view].cpu().numpy(), factor)
    jumps = torch.from_numpy(beside_jumps(depth, angle * factor, MARGIN_PIXELS // factor)).to(device)
    x, y = (torch.where(covered[:, None], pixels, 0.0) / factor).long().unbind(1)
    y, x = y.clamp(0, depth.shape[0] - 1), x.clamp(0, depth.shape[1] - 1)
    first = torch.from_numpy(depth).to(device)[y, x]
    seen = covered & (cosine > LEAST_COSINE) & ~jumps[y, x]
    seen &= (first - distance).abs() < LEAST_JUMP_PIXELS * factor * angle * distance
    return colors, torch.where(seen, cosine, 0.0)
