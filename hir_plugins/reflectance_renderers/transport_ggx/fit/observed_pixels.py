"""The pixels of a capture that a fit uses: inside the object, seen from not too grazing an angle."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints, see

INSIDE = 0.99
"""Pixels whose 3×3 neighbourhood the mask covers at least this much: at the edge the background shines in."""
CLIPPED = 0.97
"""Linear value from which a channel of a saturated pixel counts as clipped; averaging blurs it below 1."""
GRAZING = 0.1
"""Below this cosine a pixel covers too much of the surface, and normals are too uncertain, to teach anything."""


@dataclass(frozen=True, eq=False)
class Photographed:
    """Surface points with the linear colours that photographs show there."""

    points: SurfacePoints
    color: Float[Tensor, "P 3"]
    saturated: Bool[Tensor, "P 3"]
    """Channels that the sensor clipped: a yellow may be clipped in red alone."""
    pixel: Int[Tensor, "P 3"]
    """View, x and y."""

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: Tensor) -> Photographed:
        """Some of the points."""
        return Photographed(self.points.take(rows), self.color[rows], self.saturated[rows], self.pixel[rows])


def photographed(
    transport: Transport, capture: Capture, view: int, most: int, downsample: int, seed: int
) -> Photographed:
    """At most `most` pixels of one view, drawn at random from those that see the object."""
    pixels = capture.views[view].pixels(downsample)
    device = transport.surface.positions.device
    covered = inside(pixels.mask, pixels.color_linear.shape[:2])
    known = np.isfinite(pixels.color_linear).all(axis=2)
    if lost := int((covered & ~known).sum()):
        name = capture.views[view].name
        warnings.warn(f"view {name}: {lost} pixels of the object are NaN or infinite and left out", stacklevel=2)
    rows, columns = np.nonzero(covered & known)
    if len(rows) > most:
        # the draw depends on the view alone: a fit does not change because another view is added
        chosen = np.sort(np.random.default_rng((seed, view)).choice(len(rows), most, replace=False))
        rows, columns = rows[chosen], columns[chosen]
    index = torch.from_numpy(np.stack([np.full(len(rows), view), columns, rows], axis=1))
    cameras = {view: capture.cameras[view].downsampled(downsample)}
    points, found = see(transport.tracer, transport.surface, cameras, index)
    found &= (points.normal * points.to_eye).sum(1) > GRAZING
    kept = found.nonzero()[:, 0]
    color = torch.from_numpy(pixels.color_linear[rows, columns]).to(device)
    color = color.clamp_min(0) / capture.views[view].exposure
    clipped = pixels.saturated[rows, columns][:, None] & (pixels.color_linear[rows, columns] >= CLIPPED)
    saturated = torch.from_numpy(clipped).to(device)
    return Photographed(points.take(kept), color[kept], saturated[kept], index.to(device)[kept])


def inside(mask: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    from scipy.ndimage import minimum_filter

    if mask is None:
        return np.ones(shape, bool)
    return np.asarray(minimum_filter(mask, size=3) >= INSIDE)


def join(parts: list[Photographed]) -> Photographed:
    """Several views' points, one behind the other."""
    names = SurfacePoints.__dataclass_fields__
    points = SurfacePoints(*(torch.cat([getattr(p.points, name) for p in parts]) for name in names))
    color, saturated, pixel = (torch.cat([getattr(p, name) for p in parts]) for name in ("color", "saturated", "pixel"))
    return Photographed(points, color, saturated, pixel)
