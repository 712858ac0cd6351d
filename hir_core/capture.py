"""Photographs and the cameras that took them, in numpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hir_core.errors import CaptureError

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


@dataclass(frozen=True)
class Pixels:
    """What a photograph holds: linear colour (unassociated with the mask), the object's coverage, saturated pixels."""

    color_linear: NDArray[np.float32]
    """H W 3, scene-linear, not multiplied by the mask."""
    mask: NDArray[np.float32] | None
    """H W coverage of the object in 0…1, None where it is not known."""
    saturated: NDArray[np.bool_]
    """H W, where the sensor clipped: the truth may be brighter."""

    def downsampled(self, factor: int) -> Pixels:
        """Averages blocks of factor×factor pixels; colour is weighted by the mask, so backgrounds do not bleed in."""
        if factor == 1:
            return self
        mask = None if self.mask is None else block_mean(self.mask, factor)
        if self.mask is None or mask is None:
            color = block_mean(self.color_linear, factor)
        else:
            weighted = block_mean(self.color_linear * self.mask[..., None], factor)
            plain = block_mean(self.color_linear, factor)
            color = np.where(mask[..., None] > 1e-6, weighted / np.maximum(mask[..., None], 1e-6), plain)
        saturated = block_mean(self.saturated.astype(np.float32), factor) > 0
        return Pixels(color.astype(np.float32), mask, saturated)


def block_mean(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """An image (H, W, …) at 1/`factor`, each pixel the mean of a block; a border that fills no block is cut."""
    height, width = image.shape[0] // factor, image.shape[1] // factor
    if height == 0 or width == 0:
        raise CaptureError(f"an image of {image.shape[1]}×{image.shape[0]} cannot be made {factor} times smaller")
    total = np.zeros((height, width, *image.shape[2:]), np.float32)
    for row in range(factor):  # numpy's mean over two axes takes 4 to 6 times as long, at factors 4 and 2
        for column in range(factor):
            total += image[row : height * factor : factor, column : width * factor : factor]
    total /= factor**2
    return total


@dataclass(frozen=True)
class View:
    """One photograph: a name, perhaps a camera, and the way to its pixels, which are read when they are asked for."""

    name: str
    camera: Camera | None
    read: Callable[[], Pixels]
    """Reads the file; readers give a picklable callable."""
    mask: NDArray[np.float32] | None = None
    """A mask that replaces the file's own, of the picture without distortion; set by mask sources."""
    distortion: tuple[float, ...] = ()
    """OpenCV order k1 k2 p1 p2 [k3 …] of the photograph that `read` gives; `pixels` removes it, so that `camera` is a
    pinhole with the same intrinsics."""
    exposure: float = 1.0
    """Gain of this photograph: its linear values are radiance × exposure."""
    path: Path | None = None
    """The photograph's file; `hir` computes a run anew when its bytes change."""
    mask_path: Path | None = None
    """The file that `read` takes the mask from where that is not the photograph itself; watched like `path`."""

    def pixels(self, downsample: int = 1) -> Pixels:
        """Linear colour, mask and saturation at 1/`downsample` of the resolution, without lens distortion."""
        pixels = self.read()
        if self.camera is not None and any(self.distortion):
            from hir_core.lens import camera_lens, undistort

            pixels = undistort(pixels, camera_lens(self.camera, self.distortion))
        if self.mask is not None:
            if self.mask.shape != pixels.color_linear.shape[:2]:
                raise CaptureError(f"the mask of {self.name} is {self.mask.shape[1]}×{self.mask.shape[0]}, "
                                   f"its image {pixels.color_linear.shape[1]}×{pixels.color_linear.shape[0]}")
            pixels = replace(pixels, mask=self.mask)
        return pixels.downsampled(downsample)


@dataclass(frozen=True)
class OrientedPoints:
    """A point cloud: positions (N, 3), unit normals (N, 3), linear colours (N, 3)."""

    positions: Array
    normals: Array | None = None
    colors: Array | None = None


@dataclass(frozen=True)
class EnvironmentSource:
    """A light that a capture names: a lat-long file, its strength, and the axes it is given in."""

    path: Path
    strength: float = 1.0
    source_from_environment: Array = field(default_factory=lambda: np.eye(3))
    """3×3: turns a direction of `hir_exporters.conventions`' lat-long axes into the capture's own (source) axes."""


@dataclass(frozen=True)
class Capture:
    """Views of one split of a capture, in the world of DESIGN section 6 (right-handed, +Y up)."""

    path: Path
    views: tuple[View, ...]
    split: str = "train"
    points: OrientedPoints | None = None
    light_frame: Literal["world", "camera"] = "world"
    world_from_source: Array = field(default_factory=lambda: np.eye(4))
    """4×4 similarity from the axes of the files to those of `views`; whoever moves the world composes it."""
    environment: EnvironmentSource | None = None
    """The true light where the files name it: for evaluation only, never read by a fit."""
    reader: str = ""

    def transformed(self, new_from_old: Array) -> Capture:
        """Moves the whole capture (cameras, points, record) by a similarity 4×4."""
        rotation = new_from_old[:3, :3] / similarity_scale(new_from_old)
        points = self.points
        if points is not None:
            moved = points.positions @ new_from_old[:3, :3].T + new_from_old[:3, 3]
            normals = None if points.normals is None else points.normals @ rotation.T
            points = replace(points, positions=moved, normals=normals)
        views = tuple(
            v if v.camera is None else replace(v, camera=v.camera.transformed(new_from_old)) for v in self.views
        )
        return replace(self, views=views, points=points, world_from_source=new_from_old @ self.world_from_source)

    @property
    def cameras(self) -> list[Camera]:
        """The cameras of all views; an error names the first view without one."""
        missing = [v.name for v in self.views if v.camera is None]
        if missing:
            raise CaptureError(f"{self.path}: view {missing[0]} has no camera; run an initializer that finds cameras, "
                               "such as: --set 'initializers=[\"colmap\", \"visual_hull\"]'")
        return [v.camera for v in self.views if v.camera is not None]
