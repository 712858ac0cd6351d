"""The working frame, in which all fits run: the object is centred at the origin and has radius 1."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Array
from hir_core.errors import StageError
from hir_core.scene.scene import CameraLamp, Mesh, Scene


def unit_similarity(mesh: Mesh) -> NDArray[np.float64]:
    """4×4 scale and shift: the centre of the mesh's bounds goes to the origin, its farthest vertex to radius 1."""
    positions = mesh.positions.detach().cpu().numpy().astype(np.float64)
    used = positions[np.unique(mesh.faces.cpu().numpy())]
    if not len(used) or not np.isfinite(used).all():
        raise StageError(
            "the initial mesh is empty or has vertices that are not finite; try another chain of initializers"
        )
    center = (used.min(axis=0) + used.max(axis=0)) / 2
    radius = float(np.linalg.norm(used - center, axis=1).max())
    if radius == 0:
        raise StageError("the initial mesh is a single point; try another chain of initializers")
    similarity = np.eye(4)
    similarity[:3, :3] /= radius
    similarity[:3, 3] = -center / radius
    return similarity


def move_scene(scene: Scene, new_from_old: Array) -> Scene:
    """The scene after a scale and translation of the world (no rotation, so its distant light stays as it is)."""
    positions = scene.mesh.positions.detach().cpu().numpy().astype(np.float64)
    moved = positions @ new_from_old[:3, :3].T + new_from_old[:3, 3]
    tensor = torch.from_numpy(moved.astype(np.float32)).to(scene.mesh.positions.device)
    environment = scene.environment
    if environment is not None and environment.lamp is not None:
        environment = replace(environment, lamp=scaled_lamp(environment.lamp, float(new_from_old[0, 0])))
    return replace(scene, mesh=scene.mesh.with_positions(tensor), environment=environment)


def scaled_lamp(lamp: CameraLamp, scale: float) -> CameraLamp:
    """The lamp in a world where all lengths are `scale` times as large: the object is as bright as before."""
    return CameraLamp(lamp.intensity * scale**2, lamp.offset * scale, lamp.exponent, lamp.radius * scale)
