"""Photographs and the cameras that took them, in numpy; pixels are read when they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.camera import Array, Camera, similarity_scale
from hir_core.capture.lens import camera_lens, undistort
from hir_core.capture.measured_depth import DepthPixels, MeasuredDepth
from hir_core.capture.measured_irradiance import MeasuredIrradiance
from hir_core.capture.pixels import Pixels
from hir_core.errors import CaptureError


@dataclass(frozen=True)
class View:
    """One photograph: its name, its camera where it is known, and a function that reads its pixels on demand."""

    name: str
    camera: Camera | None
    read: Callable[[], Pixels]
    """Reads the file; readers provide a picklable callable."""
    mask: NDArray[np.floating] | None = None
    """A mask that replaces the one of the file, for the undistorted image; set by mask sources, in 16 bits."""
    distortion: tuple[float, ...] = ()
    """OpenCV order k1 k2 p1 p2 [k3 …], of the photograph that `read` returns. `pixels` removes the distortion, so that
    `camera` is a pinhole with the same intrinsics."""
    exposure: float = 1.0
    """The linear values of this photograph are radiance × exposure × white balance."""
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factor of each channel."""
    recorded_exposure: float | None = None
    """From EXIF: exposure time × ISO / f-number²; None where it is not recorded. A fit uses it where it explains the
    photographs better than equal exposures."""
    path: Path | None = None
    """The photograph's file; a run is computed again when its bytes change."""
    mask_path: Path | None = None
    """The file that `read` takes the mask from, where it is not the photograph itself; checked like `path`."""
    depth: MeasuredDepth | None = None
    """What a depth sensor measured beside the photograph."""
    take: str = ""
    """Name of the photograph's take: in one take the object stays where it is, under one light. Cameras of all takes
    are in the axes of the object. Empty where there is one take."""

    @property
    def gain(self) -> NDArray[np.float32]:
        """(3,): the linear values of this photograph are radiance × gain."""
        return np.asarray(self.white_balance, dtype=np.float32) * np.float32(self.exposure)

    def measured_depth(self) -> tuple[Camera, DepthPixels] | None:
        """The measured depths in world units without lens distortion, and their camera; None without any of both."""
        if self.depth is None or self.camera is None:
            return None
        return self.depth.undistorted(self.camera, self.distortion, self.name)

    def pixels(self, downsample: int = 1) -> Pixels:
        """Linear colour, mask and saturation at 1/`downsample` of the resolution, without lens distortion."""
        pixels = self.read()
        if self.camera is not None and any(self.distortion):
            pixels = undistort(pixels, camera_lens(self.camera, self.distortion))
        if self.mask is not None:
            if self.mask.shape != pixels.color_linear.shape[:2]:
                raise CaptureError(
                    f"the mask of {self.name} is {self.mask.shape[1]}×{self.mask.shape[0]}, "
                    f"its image {pixels.color_linear.shape[1]}×{pixels.color_linear.shape[0]}"
                )
            pixels = replace(pixels, mask=self.mask.astype(np.float32))
        return pixels.downsampled(downsample)


@dataclass(frozen=True)
class OrientedPoints:
    """A point cloud: positions (N, 3), unit normals (N, 3), linear colours (N, 3)."""

    positions: Array
    normals: Array | None = None
    colors: Array | None = None


@dataclass(frozen=True)
class EnvironmentSource:
    """The light of a capture: a lat-long file, its strength and its axes."""

    path: Path
    strength: float = 1.0
    source_from_environment: Array = field(default_factory=lambda: np.eye(3))
    """3×3: turns a direction of `hir_exporters.conventions`' lat-long axes into the capture's own (source) axes."""


@dataclass(frozen=True)
class Capture:
    """Views of one split of a capture, in the world of docs/conventions.md (right-handed, +Y up)."""

    path: Path
    views: tuple[View, ...]
    split: str = "train"
    points: OrientedPoints | None = None
    light_frame: Literal["world", "camera"] = "world"
    world_from_source: Array = field(default_factory=lambda: np.eye(4))
    """4×4 similarity from the axes of the files to those of `views`; `transformed` composes it."""
    environment: EnvironmentSource | None = None
    """The true light where the files contain it: for evaluation only, never used by a fit."""
    irradiance: MeasuredIrradiance | None = None
    """What a card of known reflectance beside the object shows of the light; set by an initializer, used by fits. With
    several takes, all views that show it belong to one take."""
    reader: str = ""
    metres_from: str = ""
    """What measured the metres of the files' world, such as ARKit; empty where their unit is unknown."""

    def transformed(self, new_from_old: Array) -> Capture:
        """Moves the whole capture (cameras, points, record) by a similarity 4×4."""
        scale = similarity_scale(new_from_old)
        rotation = new_from_old[:3, :3] / scale
        points = self.points
        if points is not None:
            moved = points.positions @ new_from_old[:3, :3].T + new_from_old[:3, 3]
            normals = None if points.normals is None else points.normals @ rotation.T
            points = replace(points, positions=moved, normals=normals)
        views = tuple(
            replace(
                v,
                camera=None if v.camera is None else v.camera.transformed(new_from_old),
                depth=None if v.depth is None else v.depth.scaled(scale),
            )
            for v in self.views
        )
        return replace(
            self,
            views=views,
            points=points,
            world_from_source=new_from_old @ self.world_from_source,
            irradiance=None if self.irradiance is None else self.irradiance.rotated(rotation),
        )

    @property
    def takes(self) -> tuple[str, ...]:
        """Names of the takes, in the order of their first photographs; `("",)` for a capture without takes."""
        return tuple(dict.fromkeys(view.take for view in self.views)) or ("",)

    @property
    def take_numbers(self) -> list[int]:
        """For each view the index of its take in `takes`."""
        number = {name: index for index, name in enumerate(self.takes)}
        return [number[view.take] for view in self.views]

    @property
    def cameras(self) -> list[Camera]:
        """The cameras of all views; an error names the first view without one."""
        missing = [v.name for v in self.views if v.camera is None]
        if missing:
            raise CaptureError(
                f"{self.path}: view {missing[0]} has no camera; run an initializer that finds cameras, "
                'such as: --set \'initializers=["colmap", "visual_hull"]\''
            )
        return [v.camera for v in self.views if v.camera is not None]
