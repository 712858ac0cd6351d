"""Small scenes that the reflectance tests share."""

from __future__ import annotations

import numpy as np
import torch

from hir_core.capture import Camera
from hir_core.scene import Mesh, Topology


def icosphere(subdivisions: int = 3, radius: float = 1.0) -> Mesh:
    """A sphere of 20·4^n triangles at the origin, without texture coordinates."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    faces = torch.from_numpy(np.asarray(sphere.faces, dtype=np.int64))
    return Mesh(torch.from_numpy(np.asarray(sphere.vertices, dtype=np.float32)), Topology(faces))


def bumpy_sphere(subdivisions: int = 3) -> Mesh:
    """A sphere with hills, which shadow each other."""
    sphere = icosphere(subdivisions)
    x, y, z = sphere.positions.unbind(1)
    hills = 1 + 0.15 * torch.sin(4 * x) * torch.cos(5 * y) + 0.08 * torch.sin(9 * z + 3 * x)
    return sphere.with_positions(sphere.positions * hills[:, None])


def square(half: float = 1.0, y: float = 0.0) -> Mesh:
    """Two triangles in the plane of constant y, facing up, with texture coordinates: u along +x, v along +z."""
    corners = torch.tensor([[-half, y, -half], [half, y, -half], [half, y, half], [-half, y, half]])
    faces = torch.tensor([[0, 2, 1], [0, 3, 2]])
    uvs = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return Mesh(corners, Topology(faces, faces), uvs)


def looking_at(eye: tuple[float, float, float], width: int = 32, height: int = 32, focal: float = 1.5) -> Camera:
    """A camera at `eye` that looks at the origin; `focal` in image widths."""
    position = np.array(eye, dtype=np.float64)
    forward = -position / np.linalg.norm(position)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, -rotation @ position
    intrinsics = np.array([[focal * width, 0, width / 2], [0, focal * width, height / 2], [0, 0, 1]])
    return Camera(intrinsics, world_to_camera, width, height)
