"""Pixels that one smooth part of a surface fills, so that one ray stands for the whole pixel."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.scene import Mesh

RAYS_PER_SIDE: Final = 5
"""Rays through a pixel, in each direction; an odd number, so that one of them goes through its centre."""
MAX_TURN_DEGREES: Final = 45.0
"""Largest angle between the normals that the rays of one pixel hit."""
MAX_STEP: Final = 0.05
"""Largest distance of their points from the plane of the central one, as a fraction of the object's radius."""


def uniform_pixels(mesh: Mesh, camera: Camera) -> NDArray[np.bool_]:
    """Whether each pixel (height·width, row by row) shows one smooth part of the mesh and nothing else.

    False where the outline, an edge of `MAX_TURN_DEGREES` or a step between two parts crosses the pixel. There the mean
    radiance of a pixel is that of several surfaces, and no ray through its centre has it.
    """
    positions, faces = mesh.positions.detach().double().numpy(), mesh.faces.numpy()
    radius = float(np.linalg.norm(positions - (positions.max(axis=0) + positions.min(axis=0)) / 2, axis=1).max())
    offsets = (np.arange(RAYS_PER_SIDE) + 0.5) / RAYS_PER_SIDE
    row, column, down, right = np.meshgrid(
        np.arange(camera.height), np.arange(camera.width), offsets, offsets, indexing="ij"
    )
    origins, directions = camera.rays(np.stack([column + right, row + down], axis=-1).reshape(-1, 2))
    queries = MeshQueries(positions, faces)
    face, distance = queries.first_faces_and_distances(origins, directions)
    hit = face >= 0
    a, b, c = positions[faces[np.where(hit, face, 0)]].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-30)
    points = origins + np.where(hit, distance, 0)[:, None] * directions
    shape = (camera.height * camera.width, RAYS_PER_SIDE**2)
    hit, normals, points = hit.reshape(shape), normals.reshape(*shape, 3), points.reshape(*shape, 3)
    center = RAYS_PER_SIDE**2 // 2
    cosine = (normals * normals[:, center : center + 1]).sum(axis=2)
    step = np.abs(((points - points[:, center : center + 1]) * normals[:, center : center + 1]).sum(axis=2))
    smooth = (cosine >= np.cos(np.radians(MAX_TURN_DEGREES))) & (step <= MAX_STEP * radius)
    return np.asarray((hit & smooth).all(axis=1))
