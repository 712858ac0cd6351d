"""Masks with prefix sums along rows and columns: the integral over any span takes two lookups."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Camera
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_plugins.geometry_renderers.scanlines import Crossings


@dataclass(frozen=True, eq=False)
class MaskSums:
    """One mask, linear between pixel centres and constant beyond the outermost, cropped to its non-zero part."""

    left: int
    top: int
    values: Float[Tensor, "h+2 w+2"]
    """With one more pixel on each side."""
    along_rows: Float[Tensor, "h+2 w+2"]
    """Integral from the first centre to each centre, for each row."""
    along_columns: Float[Tensor, "w+2 h+2"]

    @classmethod
    def of(cls, mask: Float[Tensor, "H W"]) -> MaskSums:
        """Sums of a mask; an empty one keeps a single pixel."""
        rows, columns = mask.any(dim=1).nonzero().reshape(-1), mask.any(dim=0).nonzero().reshape(-1)
        top, bottom = (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 1)
        left, right = (int(columns[0]), int(columns[-1]) + 1) if len(columns) else (0, 1)
        # one pixel of margin; at the border of the image the outermost pixel is repeated instead
        y = torch.arange(top - 1, bottom + 1).clamp(0, mask.shape[0] - 1)
        x = torch.arange(left - 1, right + 1).clamp(0, mask.shape[1] - 1)
        values = mask.index_select(0, y.to(mask.device)).index_select(1, x.to(mask.device)).float()
        return cls(left, top, values, _prefix_sums(values), _prefix_sums(values.T))

    def integrate(self, axis: int, position: Float[Tensor, " S"], across: Float[Tensor, " S"]) -> tuple[Tensor, Tensor]:
        """Integral along the line up to `position`, from an origin that is the same for the whole line, and the mask.

        `across` is the line's own coordinate; both in pixels of the whole image.
        """
        values = self.values if axis == 0 else self.values.T
        sums = self.along_rows if axis == 0 else self.along_columns
        origin, line_origin = (self.left, self.top) if axis == 0 else (self.top, self.left)
        lines, size = values.shape
        v = across - (line_origin - 0.5)
        low = v.floor()
        share = v - low
        within_lines = (v > -1) & (v < lines)
        low_line = low.long().clamp(0, lines - 1)
        high_line = (low.long() + 1).clamp(0, lines - 1)
        u = position - (origin - 0.5)
        cell = u.floor().clamp(0, size - 2).long()
        offset = u - cell
        integral, value = torch.zeros_like(position), torch.zeros_like(position)
        for line, weight in ((low_line, 1 - share), (high_line, share)):
            start, end = values[line, cell].double(), values[line, cell + 1].double()
            slope = end - start
            # beyond the last centre the mask is constant
            r = offset.clamp(0, 1)
            total = sums[line, cell].double() + r * (start + 0.5 * r * slope)
            total = total + (offset - 1).clamp_min(0) * end + offset.clamp_max(0) * start
            integral = integral + weight * total
            value = value + weight * (start + r * slope)
        return torch.where(within_lines, integral, 0.0), torch.where(within_lines, value, 0.0)

    def to(self, device: torch.device) -> MaskSums:
        """The same on a device."""
        if self.values.device == device:
            return self
        return MaskSums(
            self.left, self.top, self.values.to(device), self.along_rows.to(device), self.along_columns.to(device)
        )


@dataclass(frozen=True, eq=False)
class ContourTargets(SilhouetteTargets):
    """Targets with the sums of their masks."""

    sums: tuple[MaskSums, ...] = ()

    @classmethod
    def of(cls, targets: SilhouetteTargets) -> ContourTargets:
        """Adds the sums; targets that have them come back as they are."""
        if isinstance(targets, ContourTargets):
            return targets
        return cls(targets.cameras, targets.masks, tuple(MaskSums.of(m) for m in targets.masks))

    def __getitem__(self, chosen: Iterable[int]) -> ContourTargets:
        i = [int(k) for k in chosen]
        cameras: tuple[Camera, ...] = tuple(self.cameras[k] for k in i)
        return ContourTargets(cameras, tuple(self.masks[k] for k in i), tuple(self.sums[k] for k in i))

    def to(self, device: torch.device) -> ContourTargets:
        masks, sums = tuple(m.to(device) for m in self.masks), tuple(s.to(device) for s in self.sums)
        return ContourTargets(self.cameras, masks, sums)


def masks_at(sums: Sequence[MaskSums], crossings: Crossings, lines_per_pixel: int) -> tuple[Tensor, Tensor]:
    """The mask's integral along the line up to each crossing, and the mask there; crossings are ordered by view."""
    across = (crossings.line.to(crossings.position) + 0.5) / lines_per_pixel
    count = torch.bincount(crossings.view, minlength=len(sums)).tolist()
    parts = [
        mask.to(p.device).integrate(crossings.axis, p, a)
        for mask, p, a in zip(sums, crossings.position.split(count), across.split(count), strict=True)
    ]
    return torch.cat([p[0] for p in parts]), torch.cat([p[1] for p in parts])


def _prefix_sums(values: Float[Tensor, "L N"]) -> Float[Tensor, "L N"]:
    # in float64: a float32 prefix sum over a wide image loses hundredths of a pixel
    steps = 0.5 * (values[:, 1:] + values[:, :-1]).double()
    return torch.cat([torch.zeros_like(values[:, :1]), torch.cumsum(steps, dim=1).float()], dim=1)
