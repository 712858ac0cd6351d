"""Points of a mesh that bound its silhouette in an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Array, Camera
from hir_core.scene import Topology
from hir_plugins.geometry_renderers.contour_edges import CameraBatch, EdgeTable, find_segments
from hir_plugins.geometry_renderers.scanlines import find_crossings
from hir_plugins.initializers.surface.isosurface import Faces


@dataclass(frozen=True)
class OutlinePoints:
    """Where the exact outline of a mesh crosses the rows and columns of an image: points of the mesh's edges."""

    positions: Array
    """(N, 3), in the world."""
    weights: Array
    """(N,): the square of the outline's normal along the row or column; both together weigh all directions equally."""

    @classmethod
    def none(cls) -> OutlinePoints:
        """No points."""
        return cls(np.zeros((0, 3)), np.zeros(0))


def outline_points(positions: Array, faces: Faces, cameras: Sequence[Camera]) -> list[OutlinePoints]:
    """The outline of a mesh in each image: two points for each pixel of its length, at most."""
    vertices = torch.from_numpy(np.ascontiguousarray(positions, dtype=np.float64))
    triangles = torch.from_numpy(faces)
    batch = CameraBatch.of(cameras, vertices.device)
    segments = find_segments(vertices, triangles, EdgeTable.of(Topology(triangles)), batch)
    ends = segments.points(vertices)[segments.ends]
    pixels = batch.project(ends.reshape(-1, 3), segments.view.repeat_interleave(2)).reshape(-1, 2, 2)
    view, found, weights = [], [], []
    for axis in (0, 1):
        crossings = find_crossings(pixels, segments, batch, axis, 1)
        segment, fraction = crossings.segment[crossings.inside], crossings.fraction[crossings.inside]
        a, b = ends[segment].unbind(1)
        edge = pixels[segment, 1] - pixels[segment, 0]
        length2 = edge.square().sum(dim=1).clamp_min(torch.finfo(edge.dtype).tiny)
        view.append(crossings.view[crossings.inside])
        found.append(a + fraction[:, None] * (b - a))
        weights.append(edge[:, 1 - axis].square() / length2)
    owner, joined, weight = torch.cat(view).numpy(), torch.cat(found).numpy(), torch.cat(weights).numpy()
    return [OutlinePoints(joined[owner == i], weight[owner == i]) for i in range(len(cameras))]


def sample_with_slope(image: NDArray[np.floating], pixels: Array) -> tuple[Array, Array]:
    """Bilinear values (N,) of an image at `pixels` (N, 2), and their derivatives (N, 2) by x and y."""
    height, width = image.shape
    x, y = np.clip(pixels[:, 0] - 0.5, 0, width - 1.001), np.clip(pixels[:, 1] - 0.5, 0, height - 1.001)
    column, row = x.astype(int), y.astype(int)
    u, v = x - column, y - row
    a, b = image[row, column].astype(np.float64), image[row, column + 1].astype(np.float64)
    c, d = image[row + 1, column].astype(np.float64), image[row + 1, column + 1].astype(np.float64)
    value = (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v
    return value, np.stack([(b - a) * (1 - v) + (d - c) * v, (c - a) * (1 - u) + (d - b) * u], axis=1)
