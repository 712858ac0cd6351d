"""Where the chart lies in the world, from its patches in several photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hir_core.capture import Array, Camera
from hir_plugins.initializers.color_chart.chart_detection import GRID_POSITIONS, SeenChart
from hir_plugins.initializers.markers.marker_detection import MIN_VIEWS

MAX_PROJECTION_ERROR = 0.1
"""How far the patches of a photograph may lie from their projection in the median, in distances between patches. More
is a chart that moved, or a wrong detection."""
MIN_EIGENVALUE = 1e-4
"""Least eigenvalue of the mean of the equations: below, all photographs look from one side."""


def chart_in_space(charts: Mapping[int, SeenChart], cameras: Sequence[Camera]) -> Array | None:
    """3×3: (column, row, 1) of a patch to the world, by least squares; None where photographs contradict each other.

    `charts` by number of the camera. Photographs that disagree are left out one by one, the worst first, while two and
    more than half remain.
    """
    kept = dict(charts)
    while len(kept) >= MIN_VIEWS and 2 * len(kept) > len(charts):
        pose = _pose(kept, cameras)
        if pose is None:
            return None
        errors = {i: _error(chart, cameras[i], pose) for i, chart in kept.items()}
        worst = max(errors, key=lambda i: errors[i])
        if errors[worst] <= MAX_PROJECTION_ERROR:
            return pose
        del kept[worst]
    return None


def chart_normal(pose: Array) -> Array:
    """The unit normal of the chart, on its printed side."""
    normal = np.cross(pose[:, 1], pose[:, 0])
    return np.asarray(normal / np.linalg.norm(normal))


def _pose(charts: Mapping[int, SeenChart], cameras: Sequence[Camera]) -> Array | None:
    """The plane whose patches are nearest to the rays through them."""
    matrix, right, count = np.zeros((9, 9)), np.zeros(9), 0
    for i, chart in charts.items():
        origins, directions = cameras[i].rays(chart.at(GRID_POSITIONS[chart.known]))
        positions = np.column_stack([GRID_POSITIONS[chart.known], np.ones(len(origins))])
        for position, origin, direction in zip(positions, origins, directions, strict=True):
            across = np.eye(3) - np.outer(direction, direction)
            matrix += np.kron(across, np.outer(position, position))  # the unknowns are the rows of the pose, one by one
            right += np.kron(across @ origin, position)
            count += 1
    if np.linalg.eigvalsh(matrix / count)[0] < MIN_EIGENVALUE:
        return None
    return np.asarray(np.linalg.solve(matrix, right).reshape(3, 3))


def _error(chart: SeenChart, camera: Camera, pose: Array) -> float:
    """Median distance of the known patches from their projection, in distances between patches."""
    positions = np.column_stack([GRID_POSITIONS[chart.known], np.ones(int(chart.known.sum()))])
    at, depth = camera.project(positions @ pose.T)
    if not (depth > 0).all():
        return float("inf")
    return float(np.median(np.linalg.norm(at - chart.at(GRID_POSITIONS[chart.known]), axis=1)) / chart.pitch)
