"""Masks with prefix sums along rows and columns: the integral over any span takes two lookups."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Camera
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_plugins.geometry_renderers.scanlines import Crossings


@dataclass(frozen=True, eq=False)
class MaskSums:
    """B masks, linear between pixel centres and constant beyond the outermost, each cropped to its non-zero part.

    All pixels are in one array, so that one lookup serves all views; a selection of masks shares it.
    """

    values: Float[Tensor, " N"]
    """Row by row, with one more pixel on each side."""
    along_rows: Float[Tensor, " N"]
    """Integral from the first centre to each centre, for each row."""
    along_columns: Float[Tensor, " N"]
    """The same of each column, column by column."""
    first: Int[Tensor, " B"]
    """Where each mask begins in the arrays."""
    corner: Int[Tensor, "2 B"]
    """Column and row of the cropped part in the image."""
    size: Int[Tensor, "2 B"]
    """Its width and height, with the additional pixels."""

    @classmethod
    def of(cls, masks: Sequence[Float[Tensor, "H W"]]) -> MaskSums:
        """Sums of masks; an empty one keeps a single pixel."""
        device = masks[0].device if masks else torch.device("cpu")
        parts = [_part(mask) for mask in masks]

        def pairs(found: Sequence[tuple[int, int]]) -> Tensor:
            return torch.tensor(found, dtype=torch.int64, device=device).reshape(-1, 2).T.contiguous()

        corner, size = (pairs([part[i] for part in parts]) for i in range(2))
        counts = [width * height for _, (width, height) in parts]
        values, rows, columns = (torch.empty(sum(counts), device=device) for _ in range(3))
        for mask, part, *own in zip(masks, parts, *(a.split(counts) for a in (values, rows, columns)), strict=True):
            cropped = _cropped(mask, *part)
            for place, found in zip(own, (cropped, _prefix_sums(cropped), _prefix_sums(cropped.T)), strict=True):
                place.copy_(found.reshape(-1))
        return cls(values, rows, columns, torch.cumsum(size.prod(dim=0), 0) - size.prod(dim=0), corner, size)

    def __getitem__(self, chosen: Sequence[int]) -> MaskSums:
        index = torch.tensor(chosen, dtype=torch.int64, device=self.first.device)
        return replace(self, first=self.first[index], corner=self.corner[:, index], size=self.size[:, index])

    def integrate(
        self, axis: int, view: Int[Tensor, " S"], position: Float[Tensor, " S"], across: Float[Tensor, " S"]
    ) -> tuple[Float[Tensor, " S"], Float[Tensor, " S"]]:
        """Integral along a line of each view's mask up to `position`, from an origin that is the same for the whole
        line, and the mask there.

        `across` is the line's own coordinate; both in pixels of the whole image.
        """
        first, size = self.first.index_select(0, view), self.size[axis].index_select(0, view)
        lines = self.size[1 - axis].index_select(0, view)
        sums = self.along_rows if axis == 0 else self.along_columns
        v = across - (self.corner[1 - axis].index_select(0, view) - 0.5)
        low = v.floor()
        share = v - low
        within_lines = (v > -1) & (v < lines)
        low_line = low.long()
        u = position - (self.corner[axis].index_select(0, view) - 0.5)
        cell = torch.minimum(u.floor().clamp_min(0), size - 2).long()
        offset = u - cell
        # beyond the last centre the mask is constant
        r, after, before = offset.clamp(0, 1), (offset - 1).clamp_min(0), offset.clamp_max(0)
        along, over = (1, size) if axis == 0 else (lines, 1)
        start_of_line = first + cell * along
        integral, value = torch.zeros_like(position), torch.zeros_like(position)
        for number, weight in ((low_line, 1 - share), (low_line + 1, share)):
            line = torch.minimum(number.clamp_min(0), lines - 1)
            pixel = start_of_line + line * over
            start, end = (
                self.values.index_select(0, pixel).double(),
                self.values.index_select(0, pixel + along).double(),
            )
            slope = end - start
            total = sums.index_select(0, first + line * size + cell).double() + r * (start + 0.5 * r * slope)
            total = total + after * end + before * start
            integral = integral + weight * total
            value = value + weight * (start + r * slope)
        return torch.where(within_lines, integral, 0.0), torch.where(within_lines, value, 0.0)

    def to(self, device: torch.device) -> MaskSums:
        """The same on a device."""
        if self.values.device == device:
            return self
        return MaskSums(*(getattr(self, each.name).to(device) for each in fields(self)))


def _part(mask: Float[Tensor, "H W"]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The non-zero part of a mask: its first column and row; its width and height with one more pixel on each side."""
    rows, columns = mask.any(dim=1).nonzero().reshape(-1), mask.any(dim=0).nonzero().reshape(-1)
    top, bottom = (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 1)
    left, right = (int(columns[0]), int(columns[-1]) + 1) if len(columns) else (0, 1)
    return (left, top), (right - left + 2, bottom - top + 2)


def _cropped(mask: Float[Tensor, "H W"], corner: tuple[int, int], size: tuple[int, int]) -> Float[Tensor, "h+2 w+2"]:
    """A part of a mask, as `_part` returns it."""
    (left, top), (width, height) = corner, size
    # at the border of the image the outermost pixel is repeated
    y = torch.arange(top - 1, top - 1 + height, device=mask.device).clamp(0, mask.shape[0] - 1)
    x = torch.arange(left - 1, left - 1 + width, device=mask.device).clamp(0, mask.shape[1] - 1)
    return mask.index_select(0, y).index_select(1, x).float()


@dataclass(frozen=True, eq=False)
class ContourTargets(SilhouetteTargets):
    """Targets with the sums of their masks."""

    sums: MaskSums = field(default_factory=lambda: MaskSums.of([]))

    @classmethod
    def of(cls, targets: SilhouetteTargets) -> ContourTargets:
        """Adds the sums; targets that have them come back as they are."""
        if isinstance(targets, ContourTargets):
            return targets
        return cls(targets.cameras, targets.masks, MaskSums.of(targets.masks))

    def __getitem__(self, chosen: Iterable[int]) -> ContourTargets:
        i = [int(k) for k in chosen]
        cameras: tuple[Camera, ...] = tuple(self.cameras[k] for k in i)
        return ContourTargets(cameras, tuple(self.masks[k] for k in i), self.sums[i])

    def to(self, device: torch.device) -> ContourTargets:
        return ContourTargets(self.cameras, tuple(m.to(device) for m in self.masks), self.sums.to(device))


def masks_at(sums: MaskSums, crossings: Crossings, lines_per_pixel: int) -> tuple[Tensor, Tensor]:
    """The mask's integral along the line up to each crossing, and the mask there."""
    position = crossings.position
    across = (crossings.line.to(position) + 0.5) / lines_per_pixel
    return sums.to(position.device).integrate(crossings.axis, crossings.view, position, across)


def _prefix_sums(values: Float[Tensor, "L N"]) -> Float[Tensor, "L N"]:
    # in float64: a float32 prefix sum over a wide image loses hundredths of a pixel
    steps = 0.5 * (values[:, 1:] + values[:, :-1]).double()
    return torch.cat([torch.zeros_like(values[:, :1]), torch.cumsum(steps, dim=1).float()], dim=1)
