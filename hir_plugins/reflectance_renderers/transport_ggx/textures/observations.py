"""What every photograph shows of points of the surface: pixels gathered by point instead of by view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.capture import Camera, Capture
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import CLIPPED, inside
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

GRAZING = 0.15
"""Cosine below which a photograph is too stretched over the surface to tell of a point."""
MOST_BYTES = 1 << 30
"""Of photographs that are kept; larger captures are read again for every few points."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """P points in T photographs."""

    color: Float[Tensor, "T P 3"]
    """Linear, of equal exposure; 0 where the point is not seen."""
    weight: Float[Tensor, "T P"]
    """The cosine between normal and view, for that many pixels of it a photograph has; 0 where it is not seen."""
    eyes: Float[Tensor, "T 3"]
    """Where the cameras stand."""
    ceiling: Float[Tensor, " T"]
    """The value from which a photograph's channels are clipped; infinite where nothing is."""

    @property
    def count(self) -> Float[Tensor, " P"]:
        """Photographs that see each point."""
        return (self.weight > 0).sum(dim=0).float()


def sightings(
    transport: Transport,
    pictures: Pictures,
    views: Sequence[int],
    exposure: Tensor | None,
    position: Float[Tensor, "P 3"],
    facing: Float[Tensor, "P 3"],
) -> Sightings:
    """Looks points up in photographs, bilinearly, where nothing hides them; `facing` are the normals of their facets,
    `exposure` a factor of each view or None.
    """
    capture = pictures.capture
    color = position.new_zeros(len(views), len(position), 3)
    weight = position.new_zeros(len(views), len(position))
    eyes = torch.from_numpy(np.stack([capture.cameras[v].center for v in views]).astype(np.float32)).to(position)
    ceiling = position.new_full((len(views),), torch.inf)
    for row, view in enumerate(views):
        picture = pictures[view]
        factor = capture.views[view].exposure * (1.0 if exposure is None else float(exposure[view]))
        ceiling[row] = picture.ceiling / factor
        toward = normalize(eyes[row] - position, dim=1, eps=1e-12)
        cosine = (facing * toward).sum(dim=1)
        found, value, seen = picture.look_up(position, (cosine > GRAZING).nonzero()[:, 0])
        start = position[found] + transport.offset * facing[found]
        hidden = transport.tracer.occluded(start.cpu().numpy(), toward[found].cpu().numpy())
        seen &= ~torch.from_numpy(hidden).to(seen)
        color[row, found] = torch.where(seen[:, None], value.clamp_min(0) / factor, 0.0)
        weight[row, found] = torch.where(seen, cosine[found], 0.0)
    return Sightings(color, weight, eyes, ceiling)


@dataclass(frozen=True, eq=False)
class Picture:
    """A photograph to look points up in."""

    camera: Camera
    color: Float[Tensor, "H W 3"]
    whole: Bool[Tensor, "H W"]
    """Pixels that show the object alone and have a colour, as do those right of them, below and across; those of the
    last row and column have none, and are not looked up.
    """
    ceiling: float

    @classmethod
    def of(cls, capture: Capture, view: int, downsample: int) -> Picture:
        """Reads a view."""
        pixels = capture.views[view].pixels(downsample)
        known = np.asarray(np.isfinite(pixels.color_linear).all(axis=2))
        shown = inside(pixels.mask, pixels.color_linear.shape[:2]) & known
        shown[:-1, :-1] &= shown[1:, :-1] & shown[:-1, 1:] & shown[1:, 1:]
        color = torch.from_numpy(np.where(known[..., None], pixels.color_linear, 0).astype(np.float32))
        ceiling = CLIPPED if bool(pixels.saturated.any()) else np.inf
        return cls(capture.cameras[view].downsampled(downsample), color, torch.from_numpy(shown), ceiling)

    def look_up(self, position: Tensor, rows: Tensor) -> tuple[Tensor, Float[Tensor, "Q 3"], Bool[Tensor, " Q"]]:
        """Those of `rows` of (P, 3) positions that fall into the picture, their colours and whether all four pixels
        around are inside.
        """
        place, depth = (np.asarray(a) for a in self.camera.project(position[rows].cpu().numpy().astype(np.float64)))
        height, width = self.whole.shape
        corner = np.floor(np.nan_to_num(place, nan=-1, posinf=-1, neginf=-1) - 0.5)
        within = (depth > 0) & (corner >= 0).all(axis=1) & (corner < np.array([width - 1, height - 1])).all(axis=1)
        x, y = corner[within].astype(np.int64).T
        across, down = torch.from_numpy((place[within] - 0.5 - corner[within]).astype(np.float32))[..., None].unbind(1)
        first = torch.from_numpy(y * width + x)
        color = self.color.reshape(-1, 3)
        upper = torch.lerp(color.index_select(0, first), color.index_select(0, first + 1), across)
        lower = torch.lerp(color.index_select(0, first + width), color.index_select(0, first + width + 1), across)
        shown = self.whole.reshape(-1).index_select(0, first)
        value = torch.lerp(upper, lower, down)
        return rows[torch.from_numpy(within).to(rows.device)], value.to(position), shown.to(position.device)


class Pictures:
    """The photographs of a capture, ready to look points up in; the first are kept, as many as `MOST_BYTES` hold."""

    def __init__(self, capture: Capture, downsample: int) -> None:
        self.capture = capture
        self._downsample = downsample
        self._kept: dict[int, Picture] = {}
        self._left = MOST_BYTES

    def __getitem__(self, view: int) -> Picture:
        if view in self._kept:
            return self._kept[view]
        picture = Picture.of(self.capture, view, self._downsample)
        size = picture.color.numel() * picture.color.element_size()
        if size <= self._left:
            self._kept[view] = picture
            self._left -= size
        return picture
