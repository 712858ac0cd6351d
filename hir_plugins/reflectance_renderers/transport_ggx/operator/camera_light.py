"""Diffuse transport when the light moves with the camera: irradiance is computed for each pixel, not cached."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Capture
from hir_core.optimization.linear_maps import LinearMap, SparsityPattern
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.spiral import spiral_points
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.traced_directions import (
    DirectionFrames,
    traced_hemispheres,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints

UPRIGHT = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
"""Rotation from a camera's axes to those of a light that moves with it: y up and z backwards, so that the light's image
is upright."""
PIXELS_PER_CHUNK = 1 << 13
"""Pixels whose part of the matrix exists at a time where the whole is not needed."""


def camera_rotations(capture: Capture, device: torch.device) -> Float[Tensor, "N 3 3"]:
    """Rotations from the world to the axes of a light that moves with each view's camera."""
    rotations = np.stack([c.world_to_camera[:3, :3] for c in capture.cameras])
    return UPRIGHT.to(device) @ torch.from_numpy(rotations.astype(np.float32)).to(device)


def pixel_irradiance(
    transport: Transport, points: SurfacePoints, samples: int, rotation: Float[Tensor, "N 3 3"], seed: int = 0
) -> LinearMap:
    """Irradiance of each point as a matrix on the flattened pyramid; its columns for cache cells are zero."""
    parts = list(_parts(transport, points, samples, rotation, seed))
    columns, values = (torch.cat(part) for part in zip(*parts, strict=True))
    return LinearMap.from_rows(columns, values, transport.takes.count * transport.source_count)


def irradiance_of(
    transport: Transport,
    points: SurfacePoints,
    samples: int,
    rotation: Float[Tensor, "N 3 3"],
    sources: Float[Tensor, "S 3"],
    seed: int = 0,
) -> Float[Tensor, "P 3"]:
    """`pixel_irradiance(…) @ sources` without the whole matrix in memory, which takes 6 kB a point at 96 samples."""
    parts = _parts(transport, points, samples, rotation, seed)
    return torch.cat([SparsityPattern(columns, len(sources)).matrix(values) @ sources for columns, values in parts])


def _parts(
    transport: Transport, points: SurfacePoints, samples: int, rotation: Tensor, seed: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Columns and values of the matrix, in chunks of rows."""
    for start in range(0, max(len(points), 1), PIXELS_PER_CHUNK):
        part = points.take(slice(start, start + PIXELS_PER_CHUNK))
        yield _rows(transport, part, samples, rotation, seed + start)


def _rows(
    transport: Transport, points: SurfacePoints, samples: int, rotation: Tensor, seed: int
) -> tuple[Tensor, Tensor]:
    square = spiral_points(len(points), samples, seed, points.position.device)
    frames = DirectionFrames.of(points, transport.offset)
    index, weight = traced_hemispheres(transport.tracer, frames, square, transport.pyramid, rotation)
    return transport.takes.stacked_columns(index, points.view, transport.source_count), weight
