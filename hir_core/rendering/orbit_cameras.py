"""Cameras around an object at the origin."""

from __future__ import annotations

import numpy as np

from hir_core.capture import Array, Camera


def orbit_cameras(count: int, elevation_deg: float, size: int, distance: float = 3.2) -> list[Camera]:
    """`count` square cameras around the object of radius 1 at the origin, the first at +Z, the next towards +X."""
    # half the field of view is asin(1 / distance), which fits the sphere of radius 1; 10 % of margin
    focal = size / 2 / (1.1 * np.tan(np.arcsin(1 / distance)))
    intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    cameras = []
    for angle in np.arange(count) * (2 * np.pi / max(count, 1)):
        elevation = np.radians(elevation_deg)
        direction = [np.sin(angle) * np.cos(elevation), np.sin(elevation), np.cos(angle) * np.cos(elevation)]
        cameras.append(Camera(intrinsics, look_at(distance * np.array(direction)), size, size))
    return cameras


def look_at(position: Array) -> Array:
    """4×4 world_to_camera of a camera at `position` (3,) that looks at the origin; +Y is up in its image."""
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ position
    return pose
