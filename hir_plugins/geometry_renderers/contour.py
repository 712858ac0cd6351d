"""Silhouette areas and their exact derivatives from the outline alone.

By Reynolds' transport theorem `dA = ∮ (v·n) dl` and `dI = ∮ M (v·n) dl`: the derivatives of area and overlap depend
only on the motion of the outline. Values are sums of the silhouette's spans along rows and columns of the image, `∫ M`
over a span from a prefix sum. The cost is proportional to the length of the outline, not to pixels × triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Camera, View
from hir_core.capture.capture_size import CaptureSize
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_plugins.geometry_renderers.contour_edges import CameraBatch, EdgeTable, Segments, find_segments
from hir_plugins.geometry_renderers.mask_sums import ContourTargets, masks_at
from hir_plugins.geometry_renderers.options import ContourOptions
from hir_plugins.geometry_renderers.scanlines import Crossings, find_crossings

STEP_BYTES = 128 << 20
"""Memory of a step on a mesh of 100k triangles; it hardly depends on the number of views."""


@final
class Contour(GeometryRenderer):
    """Boundary-integral silhouettes, exact for triangle soups too; CPU and GPU; float64 internally."""

    def __init__(self, config: ContourOptions) -> None:
        self._config = config
        self._tables: WeakKeyDictionary[Topology, EdgeTable] = WeakKeyDictionary()

    def prepare(self, views: Sequence[View], downsample: int = 1) -> ContourTargets:
        return ContourTargets.of(SilhouetteTargets.from_views(views, downsample))

    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """Area and intersection with the mask in pixels, float64; the mask is interpolated linearly between pixel
        centres.

        The derivative of a piece of outline is measured on rows with weight n_x² and on columns with n_y²: each
        sample's weight is bounded, and both together sample all directions about once a pixel.
        """
        cameras, segments, pixels = self._outline(mesh, targets.cameras)
        views = len(targets)
        area = torch.zeros(views, dtype=torch.float64, device=mesh.positions.device)
        overlap = torch.zeros_like(area)
        if views == 0:
            return area, overlap
        sums = ContourTargets.of(targets).sums
        points = segments.points(mesh.positions.double())
        per_line = 1.0 / self._config.lines_per_pixel
        for axis in (0, 1):
            crossings = find_crossings(pixels, segments, cameras, axis, self._config.lines_per_pixel)
            sign = torch.where(crossings.leaving, per_line, -per_line).double()
            integral, coverage = masks_at(sums, crossings, self._config.lines_per_pixel)
            # the mean of rows and columns
            area = area.index_add(0, crossings.view, 0.5 * sign * crossings.position)
            overlap = overlap.index_add(0, crossings.view, 0.5 * sign * integral)
            if torch.is_grad_enabled() and mesh.positions.requires_grad:
                motion = sign * crossings.inside * self._motion(points, segments, crossings, cameras, pixels)
                area = area.index_add(0, crossings.view, motion)
                overlap = overlap.index_add(0, crossings.view, motion * coverage)
        return area, overlap

    def memory(self, size: CaptureSize, views_per_step: int) -> int:
        """Masks, and their values and sums along rows and columns; the outlines of a step are small beside them."""
        del views_per_step
        return 16 * size.pixels + STEP_BYTES

    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Float[Tensor, "B H W"]:
        """Antialiased coverage (box filter), the mean of rows and columns; views smaller than the largest are padded
        with 0.
        """
        batch, segments, pixels = self._outline(mesh, cameras)
        if not cameras:
            return mesh.positions.new_zeros((0, 0, 0))
        points = segments.points(mesh.positions.double())
        lines = self._config.render_lines
        height, width = int(batch.heights.max()), int(batch.widths.max())
        images = []
        for axis in (0, 1):
            crossings = find_crossings(pixels, segments, batch, axis, lines)
            position = crossings.position
            if torch.is_grad_enabled() and mesh.positions.requires_grad:
                moving = self._position(points, segments, crossings, batch)
                position = torch.where(crossings.inside, position + moving - moving.detach(), position)
            shape = (len(cameras), height, width) if axis == 0 else (len(cameras), width, height)
            image = _coverage(crossings, position, shape, lines)
            images.append(image if axis == 0 else image.transpose(1, 2))
        return (0.5 * (images[0] + images[1])).clamp(0, 1).to(mesh.positions.dtype)

    def _outline(self, mesh: Mesh, cameras: Sequence[Camera]) -> tuple[CameraBatch, Segments, Tensor]:
        device = mesh.positions.device
        positions = mesh.positions.detach().double()
        batch = CameraBatch.of(cameras or [_PLACEHOLDER], device)
        table = self._tables.get(mesh.topology)
        if table is None:
            table = self._tables[mesh.topology] = EdgeTable.of(mesh.topology)
        segments = find_segments(positions, mesh.faces, table, batch)
        ends = segments.points(positions).index_select(0, segments.ends.reshape(-1))
        pixels = batch.project(ends, segments.view.repeat_interleave(2)).reshape(-1, 2, 2)
        return batch, segments, pixels

    @staticmethod
    def _position(points: Tensor, segments: Segments, crossings: Crossings, cameras: CameraBatch) -> Tensor:
        """Where the line meets the edge, differentiable in the edge's ends."""
        ends = points.index_select(0, segments.ends[crossings.segment].reshape(-1))
        pixels = cameras.project(ends, crossings.view.repeat_interleave(2)).reshape(-1, 2, 2)
        (u0, u1), (v0, v1) = pixels[:, :, crossings.axis].unbind(1), pixels[:, :, 1 - crossings.axis].unbind(1)
        v = v0.detach() + crossings.fraction * (v1 - v0).detach()
        return u0 + (v - v0) / (v1 - v0) * (u1 - u0)

    @staticmethod
    def _motion(
        points: Tensor, segments: Segments, crossings: Crossings, cameras: CameraBatch, pixels: Tensor
    ) -> Tensor:
        """Zero, with the derivative of position times the squared component of the outline's normal along the line."""
        ends = points.index_select(0, segments.ends[crossings.segment].reshape(-1))
        moving = cameras.project(ends, crossings.view.repeat_interleave(2)).reshape(-1, 2, 2)
        edge = pixels[crossings.segment]
        du, dv = (edge[:, 1] - edge[:, 0])[:, [crossings.axis, 1 - crossings.axis]].unbind(1)
        length2 = (du * du + dv * dv).clamp_min(torch.finfo(du.dtype).tiny)
        u = moving[:, :, crossings.axis]
        v = moving[:, :, 1 - crossings.axis]
        t = crossings.fraction
        slide_u = u[:, 0] + t * (u[:, 1] - u[:, 0])
        slide_v = v[:, 0] + t * (v[:, 1] - v[:, 0])
        motion = (dv * dv / length2) * slide_u - (du * dv / length2) * slide_v
        return motion - motion.detach()


_PLACEHOLDER = Camera(torch.eye(3).numpy(), torch.eye(4).numpy(), 1, 1)
"""Replaces an empty list of cameras, so that shapes stay defined."""


def _coverage(crossings: Crossings, position: Tensor, shape: tuple[int, int, int], lines_per_pixel: int) -> Tensor:
    """Accumulates spans into pixels: a span covers the rest of its first pixel and all following ones."""
    views, lines, size = shape
    pixel = position.detach().floor().clamp(0, size).long()
    share = position - pixel
    sign = torch.where(crossings.leaving, -1.0, 1.0).double() / lines_per_pixel
    row = (crossings.view * lines + crossings.line // lines_per_pixel) * (size + 2) + pixel
    steps = torch.zeros(views * lines * (size + 2), dtype=torch.float64, device=position.device)
    steps = steps.index_add(0, row, sign * (1 - share)).index_add(0, row + 1, sign * share)
    return torch.cumsum(steps.reshape(views, lines, size + 2), dim=2)[:, :, :size]
