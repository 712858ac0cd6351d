"""Depth that a sensor measured beside a photograph, such as ARKit's LiDAR: read on demand, in the cameras' world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.camera import Camera
from hir_core.capture.lens import Lens, camera_lens
from hir_core.errors import CaptureError

MAX_ASPECT_DIFFERENCE = 0.02
"""Of a depth map and its photograph, as a share: sensors of another resolution are cropped to the photograph."""


@dataclass(frozen=True)
class DepthPixels:
    """Depths on a grid that covers the photograph; its resolution may be lower."""

    depth: NDArray[np.float32]
    """(H, W), along the optical axis; 0 where unknown."""
    confidence: NDArray[np.float32]
    """(H, W), 0…1; 0 where the depth is unknown."""


@dataclass(frozen=True)
class MeasuredDepth:
    """Where the depth of a photograph is, and how it is converted to the world of the cameras."""

    read: Callable[[], DepthPixels]
    """Reads the files, for the photograph as taken; readers provide a picklable callable."""
    world_per_unit: float = 1.0
    """Length in the world of one unit that `read` returns; `Capture.transformed` changes it with the world."""
    lens: Lens | None = None
    """The photograph's lens where its view has undistorted pixels already."""
    paths: tuple[Path, ...] = ()
    """The files; a run is computed again when their bytes change."""
    min_confidence: float = 0.25
    """Depths of a lower confidence are unknown; a run sets `depth_maps.min_confidence`."""

    def scaled(self, factor: float) -> MeasuredDepth:
        """The same depth in a world in which lengths are `factor` times as large."""
        return replace(self, world_per_unit=self.world_per_unit * factor)

    def undistorted(self, camera: Camera, distortion: tuple[float, ...], name: str) -> tuple[Camera, DepthPixels]:
        """The pinhole camera of the depth map, and depths in world units, without the lens distortion of the view.

        Depths are not interpolated: each is that of the nearest pixel as taken. Those below `min_confidence` are
        unknown. A map whose aspect ratio is not that of the photograph raises `CaptureError`.
        """
        pixels = self.read()
        height, width = pixels.depth.shape
        across, down = width / camera.width, height / camera.height
        if abs(across / down - 1) > MAX_ASPECT_DIFFERENCE:
            raise CaptureError(
                f"the depth map of {name} is {width}×{height}, its photograph {camera.width}×{camera.height}; give "
                "them the same aspect ratio"
            )
        small = replace(camera, intrinsics=np.diag([across, down, 1.0]) @ camera.intrinsics, width=width, height=height)
        lens = self.lens if self.lens is not None or not any(distortion) else camera_lens(camera, distortion)
        if lens is not None:
            pixels = _resampled(pixels, lens, across, down)
        known = pixels.confidence >= self.min_confidence
        depth = np.where(known, pixels.depth * np.float32(self.world_per_unit), 0).astype(np.float32)
        return small, DepthPixels(depth, np.where(known, pixels.confidence, 0).astype(np.float32))


def _resampled(pixels: DepthPixels, lens: Lens, across: float, down: float) -> DepthPixels:
    height, width = pixels.depth.shape
    rows, columns = np.mgrid[:height, :width]
    photograph = np.stack([(columns.ravel() + 0.5) / across, (rows.ravel() + 0.5) / down], axis=1)
    taken = lens.distort(photograph) * [across, down]
    column, row = np.floor(taken).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)

    def at(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(inside, values[row, column], 0).reshape(height, width).astype(np.float32)

    return DepthPixels(at(pixels.depth), at(pixels.confidence))
