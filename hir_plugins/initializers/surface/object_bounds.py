"""A bounding sphere of the object, from the cameras' viewing directions and the capture's points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture


def object_bounding_sphere(capture: Capture) -> tuple[Array, float]:
    """Centre (3,) and radius of the object.

    With at least 20 points it is the sphere around those that most photographs show. Otherwise its centre is where the
    cameras look, and its radius a quarter of their median distance.
    """
    cameras = [view.camera for view in capture.views if view.camera is not None]
    o = np.array([c.center for c in cameras])
    d = np.array([c.world_to_camera[2, :3] for c in cameras])
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    focus = np.linalg.lstsq(across.sum(axis=0), np.einsum("vij,vj->i", across, o), rcond=None)[0]
    distance = float(np.median(np.linalg.norm(o - focus, axis=1)))
    if capture.points is None or len(capture.points.positions) < 20:
        return focus, max(0.25 * distance, 1e-12)
    points = capture.points.positions
    near = points[_in_most_photographs(points, cameras)]
    if len(near) < 20:
        near = points
    center = np.median(near, axis=0)
    radius = float(np.quantile(np.linalg.norm(near - center, axis=1), 0.9))
    return center, max(radius, 1e-6 * max(distance, 1e-12))


def _in_most_photographs(points: Array, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Which points (N,) are inside the images of two thirds of all cameras: the object, not the background."""
    inside = np.zeros(len(points))
    for camera in cameras:
        pixels, depth = camera.project(points)
        size = [camera.width, camera.height]
        inside += (depth > 0) & (pixels >= 0).all(axis=1) & (pixels <= size).all(axis=1)
    return inside >= 2 / 3 * len(cameras)
