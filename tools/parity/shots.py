"""Cameras around an asset, in the conventions of other programs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from hir_exporters.asset import AssetMesh

from hir_core.capture import Camera
from hir_core.rendering.orbit_cameras import orbit_cameras

ELEVATION_DEG: Final = 22.0
SIDES: Final = 3


def cameras_around(mesh: AssetMesh, size: int, sides: int = SIDES) -> list[Camera]:
    """`sides` square cameras that see the whole mesh, at even angles, the first at +Z."""
    center = (mesh.positions.min(axis=0) + mesh.positions.max(axis=0)).astype(np.float64) / 2
    radius = float(np.linalg.norm(mesh.positions - center, axis=1).max())
    found = []
    for camera in orbit_cameras(sides, ELEVATION_DEG, size):
        pose = camera.world_to_camera.copy()
        pose[:3, 3] = pose[:3, 3] * radius - pose[:3, :3] @ center
        found.append(replace(camera, world_to_camera=pose))
    return found


def shot_document(camera: Camera) -> dict[str, Any]:
    """A camera in the convention of three.js, Babylon.js, Filament and Blender: -z forward, y up; column-major."""
    camera_to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
    distance = float(np.linalg.norm(camera_to_world[:3, 3]))
    return {
        "width": camera.width,
        "height": camera.height,
        "fov_y_deg": float(np.degrees(2 * np.arctan(camera.height / (2 * camera.intrinsics[1, 1])))),
        "near": 0.01 * max(distance, 1e-6),
        "far": 10 * max(distance, 1e-6),
        "camera_to_world_columns": camera_to_world.T.reshape(-1).tolist(),
    }
