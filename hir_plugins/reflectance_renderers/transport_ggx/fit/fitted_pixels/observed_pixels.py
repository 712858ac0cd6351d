"""The pixels of a capture that a fit uses: inside the object, at view angles that are not too grazing."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.optimization.linear_maps import LinearMap
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints, visible_points

MIN_MASK_COVERAGE = 0.99
"""Least mask value in a pixel's 3×3 neighbourhood: at silhouettes the background mixes in."""
CLIPPED_LINEAR_LEVEL = 0.97
"""Linear value from which a channel of a saturated pixel counts as clipped; averaging reduces it below 1."""
MIN_VIEW_COSINE = 0.1
"""Least cosine between normal and view: beyond, a pixel covers too much surface and normals are too uncertain."""


@dataclass(frozen=True, eq=False)
class ObservedPixels:
    """Surface points behind pixels, with the linear colours of these pixels."""

    points: SurfacePoints
    color: Float[Tensor, "P 3"]
    saturated: Bool[Tensor, "P 3"]
    """Channels that the sensor clipped: a yellow may be clipped in red only."""
    pixel: Int[Tensor, "P 3"]
    """View, x and y."""
    irradiance: dict[int, LinearMap] = field(default_factory=dict)
    """Irradiance under a light that moves with the camera, by number of the batch: material hypotheses share it."""

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: Tensor) -> ObservedPixels:
        """The pixels of `rows`."""
        return ObservedPixels(self.points.take(rows), self.color[rows], self.saturated[rows], self.pixel[rows])


def observe_pixels(
    transport: Transport, capture: Capture, view: int, max_pixels: int, downsample: int, seed: int
) -> ObservedPixels:
    """At most `max_pixels` pixels of one view, drawn at random from those that see the object."""
    pixels = capture.views[view].pixels(downsample)
    device = transport.surface.positions.device
    inside = interior_mask(pixels.mask, pixels.color_linear.shape[:2])
    known = np.isfinite(pixels.color_linear).all(axis=2)
    if dropped := int((inside & ~known).sum()):
        name = capture.views[view].name
        warnings.warn(f"view {name}: {dropped} pixels of the object are NaN or infinite and are not used", stacklevel=2)
    rows, columns = np.nonzero(inside & known)
    if len(rows) > max_pixels:
        # the draw depends on the view only, so another view does not change it
        chosen = np.sort(np.random.default_rng((seed, view)).choice(len(rows), max_pixels, replace=False))
        rows, columns = rows[chosen], columns[chosen]
    index = torch.from_numpy(np.stack([np.full(len(rows), view), columns, rows], axis=1))
    cameras = {view: capture.cameras[view].downsampled(downsample)}
    points, visible = visible_points(transport.tracer, transport.surface, cameras, index)
    visible &= points.view_cosine > MIN_VIEW_COSINE
    rows_kept = visible.nonzero()[:, 0]
    color = torch.from_numpy(pixels.color_linear[rows, columns]).to(device)
    color = color.clamp_min(0) / torch.from_numpy(capture.views[view].gain).to(device)
    clipped = pixels.saturated[rows, columns][:, None] & (pixels.color_linear[rows, columns] >= CLIPPED_LINEAR_LEVEL)
    saturated = torch.from_numpy(clipped).to(device)
    return ObservedPixels(points.take(rows_kept), color[rows_kept], saturated[rows_kept], index.to(device)[rows_kept])


def interior_mask(mask: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """Pixels whose 3×3 neighbourhood shows only the object; all without a mask."""
    from scipy.ndimage import minimum_filter

    if mask is None:
        return np.ones(shape, bool)
    return np.asarray(minimum_filter(mask, size=3) >= MIN_MASK_COVERAGE)


def concatenate(parts: list[ObservedPixels]) -> ObservedPixels:
    """The pixels of several views in one."""
    names = SurfacePoints.__dataclass_fields__
    points = SurfacePoints(*(torch.cat([getattr(p.points, name) for p in parts]) for name in names))
    color, saturated, pixel = (torch.cat([getattr(p, name) for p in parts]) for name in ("color", "saturated", "pixel"))
    return ObservedPixels(points, color, saturated, pixel)
