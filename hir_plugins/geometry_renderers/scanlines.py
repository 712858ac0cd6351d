"""Crossings of the outline with equidistant lines through the image: rows, or columns."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_plugins.geometry_renderers.contour_edges import TIE_PIXELS, CameraBatch, Segments


@dataclass(frozen=True, eq=False)
class Crossings:
    """Points where the silhouette begins or ends along a line, sorted along it, in pairs."""

    axis: int
    """0: the lines are rows and `position` is x; 1: columns and y."""
    view: Int[Tensor, " S"]
    line: Int[Tensor, " S"]
    """Number of the line in its view; it lies at (line + ½) / lines_per_pixel."""
    position: Float[Tensor, " S"]
    """Along the line, in pixels, clamped to the frame."""
    leaving: Bool[Tensor, " S"]
    segment: Int[Tensor, " S"]
    fraction: Float[Tensor, " S"]
    """Position along the segment, 0…1."""
    inside: Bool[Tensor, " S"]
    """In the frame. The others lie where the frame cuts the silhouette; they do not move."""


def find_crossings(
    pixels: Float[Tensor, "N 2 2"], segments: Segments, cameras: CameraBatch, axis: int, lines_per_pixel: int
) -> Crossings:
    """The outline on every row (axis 0) or column (axis 1) of all views, without gradient."""
    along, across = pixels[:, :, axis], pixels[:, :, 1 - axis]
    extent = (cameras.widths, cameras.heights)
    lines = extent[1 - axis] * lines_per_pixel
    # half-open intervals: a line through a vertex meets exactly one of its two edges
    index = torch.ceil(across * lines_per_pixel - 0.5)
    index = torch.minimum(index.clamp_min(0), lines.index_select(0, segments.view)[:, None].to(index)).to(torch.int64)
    one, other = index.unbind(1)
    first = torch.minimum(one, other)  # torch reduces two columns of integers fifty times slower
    count = torch.maximum(one, other) - first
    segment = torch.repeat_interleave(torch.arange(len(count), device=count.device), count)

    def of_segment(values: Tensor) -> Tensor:
        return values.index_select(0, segment)  # several times faster than indexing

    line = torch.arange(len(segment), device=count.device) + of_segment(first + count - torch.cumsum(count, 0))
    view = of_segment(segments.view)

    (u0, u1), (v0, v1) = ([of_segment(end) for end in ends.T.contiguous()] for ends in (along, across))
    # from the end nearer the origin, so that both copies of a duplicated edge give the same bits
    swap = v0 > v1
    low_v, high_v = torch.where(swap, v1, v0), torch.where(swap, v0, v1)
    low_u, high_u = torch.where(swap, u1, u0), torch.where(swap, u0, u1)
    fraction = ((line.to(v0) + 0.5) / lines_per_pixel - low_v) / (high_v - low_v)
    fraction = fraction.clamp(0, 1)
    position = low_u + fraction * (high_u - low_u)
    fraction = torch.where(swap, 1 - fraction, fraction)

    step = of_segment(segments.winding) * torch.where(swap, -1, 1)
    if axis == 1:
        step = -step
    size = extent[axis].index_select(0, view).to(position)
    inside = (position > 0) & (position < size)
    position = torch.minimum(position.clamp_min(0), size)
    width = int(extent[axis].max()) + 2.0
    stride = int(lines.max()) if len(lines) else 0
    order = torch.argsort(
        (view * stride + line).to(position) * width + position - TIE_PIXELS * step.sign(), stable=True
    )
    step = step.index_select(0, order)
    after = torch.cumsum(step, 0)
    before = after - step
    kept = (before > 0) != (after > 0)
    chosen = order[kept]
    return Crossings(
        axis,
        view.index_select(0, chosen),
        line.index_select(0, chosen),
        position.index_select(0, chosen),
        before[kept] > 0,
        segment.index_select(0, chosen),
        fraction.index_select(0, chosen),
        inside.index_select(0, chosen),
    )
