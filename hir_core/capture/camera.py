"""A pinhole camera in OpenCV axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in OpenCV axes (x right, y down, looks along +z); pixel centres lie at .5."""

    intrinsics: Array
    """3×3, in pixels."""
    world_to_camera: Array
    """4×4 rigid transform."""
    width: int
    height: int
    distortion: tuple[float, ...] = ()
    """OpenCV order k1 k2 p1 p2 [k3 …]; empty where there is none, as in all views that built-in readers give."""

    @property
    def center(self) -> Array:
        """Position in the world (3,)."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def focal_length(self) -> float:
        """In pixels, the geometric mean of both directions; its inverse is the width of a pixel at distance 1."""
        return float(np.sqrt(abs(np.linalg.det(self.intrinsics[:2, :2]))))

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels (N, 2) and depths (N,) of world points (N, 3), without distortion; depth ≤ 0 is behind the camera."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        pixels = (local @ self.intrinsics.T)[:, :2] / safe[:, None]
        return pixels, depth

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Origins (N, 3) and unit directions (N, 3) in the world of the rays through `pixels` (N, 2)."""
        homogeneous = np.concatenate([pixels, np.ones_like(pixels[:, :1])], axis=1)
        directions = homogeneous @ np.linalg.inv(self.intrinsics).T @ self.world_to_camera[:3, :3]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.center, directions.shape).copy(), directions

    def pinhole(self) -> Camera:
        """The camera of the undistorted photograph, which has the same intrinsics."""
        return replace(self, distortion=())

    def downsampled(self, factor: int) -> Camera:
        """The camera of the image that `Pixels.downsampled(factor)` makes; a border that fills no block is cut."""
        if factor == 1:
            return self
        intrinsics = np.diag([1 / factor, 1 / factor, 1.0]) @ self.intrinsics
        return replace(self, intrinsics=intrinsics, width=self.width // factor, height=self.height // factor)

    def transformed(self, world_from_old: Array) -> Camera:
        """The same camera after the world is moved by a similarity 4×4; lengths in the camera scale with it."""
        scale = similarity_scale(world_from_old)
        old_from_world = np.linalg.inv(world_from_old)
        moved = self.world_to_camera @ old_from_world
        moved[:3] *= scale
        return replace(self, world_to_camera=moved)


def similarity_scale(transform: Array) -> float:
    """Uniform scale of a 4×4 similarity."""
    return float(np.cbrt(abs(np.linalg.det(transform[:3, :3]))))
