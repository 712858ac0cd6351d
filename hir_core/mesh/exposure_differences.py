"""How the exposures of photographs differ, from the colours that they show at the same places of a mesh."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from hir_core.capture import Capture, View
from hir_core.capture.relative_exposures import corrections_of_takes
from hir_core.mesh.ray_casting import MeshQueries

POINTS = 4_000
"""Vertices at which photographs are compared."""
SIDE_PIXELS = 512
"""Photographs are reduced by the largest whole factor that leaves this many pixels on the longer side."""
LEAST_COSINE = 0.25
"""Between normal and ray: highlights and the edge of the object are at grazing angles."""
LEAST_COVERAGE = 0.99
"""Mask value from which a pixel shows the object alone."""
SHADOW_RAY_OFFSET = 2e-3
"""Distance of the start of a shadow ray from the surface, in units of the mesh's largest extent."""

Array = NDArray[np.float64]


def exposure_corrections(
    positions: Float[NDArray[np.floating], "V 3"],
    normals: Float[NDArray[np.floating], "V 3"],
    faces: NDArray[np.integer],
    capture: Capture,
) -> Float[Array, "views 3"] | None:
    """Factors that make the photographs of each take equally exposed; None where they are, or where one lacks a camera.

    The mesh (unit normals at its vertices) and the capture are in one frame, with the object near the origin.
    """
    if len(positions) == 0 or len(capture.views) < 2 or any(view.camera is None for view in capture.views):
        return None
    chosen = slice(None, None, max(1, len(positions) // POINTS))
    points, directions = np.asarray(positions[chosen], np.float64), np.asarray(normals[chosen], np.float64)
    tracer = MeshQueries(positions, faces)
    start = points + SHADOW_RAY_OFFSET * float(np.ptp(positions, axis=0).max()) * directions
    color = np.zeros((len(capture.views), len(points), 3))
    known = np.zeros(color.shape, bool)
    for i, view in enumerate(capture.views):
        rows, seen, certain = _colors(view, points, directions, start, tracer)
        color[i, rows], known[i, rows] = seen, certain
    toward = np.stack([camera.center for camera in capture.cameras]) - points.mean(axis=0)
    return corrections_of_takes(color, known, toward, capture.take_numbers)


def _colors(
    view: View, points: Array, normals: Array, start: Array, tracer: MeshQueries
) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Rows of the points that the view shows, their linear colours, and which channels are not clipped."""
    assert view.camera is not None
    factor = max(1, max(view.camera.width, view.camera.height) // SIDE_PIXELS)
    camera, pixels = view.camera.downsampled(factor), view.pixels(factor)
    height, width = pixels.color_linear.shape[:2]
    toward = camera.center - points
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-30)
    place, depth = camera.project(points)
    column, row = np.floor(np.clip(np.nan_to_num(place, nan=-1), -1, 1 << 30)).astype(np.int64).T
    shown = (depth > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    rows = np.flatnonzero(shown & ((normals * toward).sum(axis=1) > LEAST_COSINE))
    if pixels.mask is not None:
        rows = rows[pixels.mask[row[rows], column[rows]] >= LEAST_COVERAGE]
    rows = rows[~tracer.occluded(start[rows], toward[rows])]
    at = row[rows], column[rows]
    return rows, pixels.color_linear[at].astype(np.float64), ~pixels.saturated[at][:, None].repeat(3, axis=1)
