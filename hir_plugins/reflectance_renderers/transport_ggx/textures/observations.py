"""The colours of surface points in all photographs: pixels ordered by point instead of by view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.capture import Camera, Capture
from hir_core.scene.bilinear import AxisNeighbours, bilinear_values
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import (
    CLIPPED_LINEAR_LEVEL,
    interior_mask,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

MIN_OBSERVATION_COSINE = 0.15
"""Least cosine between normal and view: a photograph at a more grazing angle has too few pixels on the surface."""
MAX_CACHE_BYTES = 1 << 30
"""Photographs in memory; the others of a larger capture are read again for every chunk of points."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Colours of P points in T photographs."""

    color: Float[Tensor, "T P 3"]
    """Linear, of equal exposure; 0 where the point is not seen."""
    weight: Float[Tensor, "T P"]
    """Cosine between normal and view, to which the number of pixels is proportional; 0 where the point is not seen."""
    eyes: Float[Tensor, "T 3"]
    """Camera centres."""
    ceiling: Float[Tensor, "T 3"]
    """Value from which a channel of a photograph is clipped; infinite if none is."""

    @property
    def count(self) -> Float[Tensor, " P"]:
        """Number of photographs that see each point."""
        return (self.weight > 0).sum(dim=0).float()


def observe(
    transport: Transport,
    images: ImageCache,
    views: Sequence[int],
    exposure: Float[Tensor, "views 3"] | None,
    position: Float[Tensor, "P 3"],
    face_normal: Float[Tensor, "P 3"],
) -> Observations:
    """Bilinear lookups of points in the photographs where they are not occluded.

    `face_normal` are the normals of the points' faces, `exposure` holds factors of each view and channel.
    """
    if not views:
        return _no_observations(position)
    capture = images.capture
    color = position.new_zeros(len(views), len(position), 3)
    weight = position.new_zeros(len(views), len(position))
    eyes = torch.from_numpy(np.stack([capture.cameras[v].center for v in views]).astype(np.float32)).to(position)
    ceiling = position.new_full((len(views), 3), torch.inf)
    for number, view in enumerate(views):
        image = images[view]
        factor = torch.from_numpy(capture.views[view].gain).to(position)
        if exposure is not None:
            factor = factor * exposure[view].to(position)
        ceiling[number] = image.ceiling / factor
        toward = normalize(eyes[number] - position, dim=1, eps=1e-12)
        cosine = (face_normal * toward).sum(dim=1)
        rows, value, seen = image.sample(position, (cosine > MIN_OBSERVATION_COSINE).nonzero()[:, 0])
        start = position[rows] + transport.offset * face_normal[rows]
        occluded = transport.tracer.occluded(start.cpu().numpy(), toward[rows].cpu().numpy())
        seen &= ~torch.from_numpy(occluded).to(seen)
        color[number, rows] = torch.where(seen[:, None], value.clamp_min(0) / factor, 0.0)
        weight[number, rows] = torch.where(seen, cosine[rows], 0.0)
    return Observations(color, weight, eyes, ceiling)


def _no_observations(position: Float[Tensor, "P 3"]) -> Observations:
    """One photograph that shows none of the points."""
    color, weight = position.new_zeros(1, len(position), 3), position.new_zeros(1, len(position))
    return Observations(color, weight, position.new_ones(1, 3), position.new_full((1, 3), torch.inf))


@dataclass(frozen=True, eq=False)
class LookupImage:
    """A photograph in which points are looked up."""

    camera: Camera
    color: Float[Tensor, "H W 3"]
    complete: Bool[Tensor, "H W"]
    """Pixels that show only the object and have a colour, and so do their right, lower and lower right neighbours.
    Pixels of the last row and column lack these neighbours and are never looked up."""
    ceiling: float

    @classmethod
    def of(cls, capture: Capture, view: int, downsample: int) -> LookupImage:
        """The photograph of a view."""
        pixels = capture.views[view].pixels(downsample)
        known = np.asarray(np.isfinite(pixels.color_linear).all(axis=2))
        complete = interior_mask(pixels.mask, pixels.color_linear.shape[:2]) & known
        complete[:-1, :-1] &= complete[1:, :-1] & complete[:-1, 1:] & complete[1:, 1:]
        color = torch.from_numpy(np.where(known[..., None], pixels.color_linear, 0).astype(np.float32))
        ceiling = CLIPPED_LINEAR_LEVEL if bool(pixels.saturated.any()) else np.inf
        return cls(capture.cameras[view].downsampled(downsample), color, torch.from_numpy(complete), ceiling)

    def sample(self, position: Tensor, rows: Tensor) -> tuple[Tensor, Float[Tensor, "Q 3"], Bool[Tensor, " Q"]]:
        """Those of `rows` of (P, 3) positions that are inside the image, their colours, and whether all four pixels
        around them are complete.
        """
        pixel, depth = (np.asarray(a) for a in self.camera.project(position[rows].cpu().numpy().astype(np.float64)))
        height, width = self.complete.shape
        corner = np.floor(np.nan_to_num(pixel, nan=-1, posinf=-1, neginf=-1) - 0.5)
        within = (depth > 0) & (corner >= 0).all(axis=1) & (corner < np.array([width - 1, height - 1])).all(axis=1)
        column, row = (torch.from_numpy(index) for index in corner[within].astype(np.int64).T)
        fraction = torch.from_numpy((pixel[within] - 0.5 - corner[within]).astype(np.float32))
        x = AxisNeighbours(column, column + 1, fraction[:, 0])
        y = AxisNeighbours(row, row + 1, fraction[:, 1])
        value = bilinear_values(self.color.reshape(-1, 3), x, y, width)
        complete = self.complete.reshape(-1).index_select(0, row * width + column)
        return rows[torch.from_numpy(within).to(rows.device)], value.to(position), complete.to(position.device)


class ImageCache:
    """The photographs of a capture for lookups; as many as `MAX_CACHE_BYTES` admits stay in memory."""

    def __init__(self, capture: Capture, downsample: int) -> None:
        self.capture = capture
        self._downsample = downsample
        self._cached: dict[int, LookupImage] = {}
        self._free_bytes = MAX_CACHE_BYTES

    def __getitem__(self, view: int) -> LookupImage:
        if view in self._cached:
            return self._cached[view]
        image = LookupImage.of(self.capture, view, self._downsample)
        size = image.color.numel() * image.color.element_size()
        if size <= self._free_bytes:
            self._cached[view] = image
            self._free_bytes -= size
        return image
