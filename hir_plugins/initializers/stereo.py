"""Initializer: multi-view stereo on CPU or GPU, fused with the visual hull where there are masks."""
# ruff: noqa: TID253 - loaded when it runs

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Array, Capture, OrientedPoints, View
from hir_core.errors import CaptureError, StageError
from hir_core.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.carving import Volume
from hir_plugins.initializers.colmap import object_ball
from hir_plugins.initializers.depth_fusion import consistent, fuse_into, oriented_points
from hir_plugins.initializers.depth_maps import DepthMap, StereoView, depth_map, neighbours
from hir_plugins.initializers.options import PoissonOptions, StereoOptions, VisualHullOptions
from hir_plugins.initializers.poisson import poisson_surface
from hir_plugins.initializers.surface import extract_surface, keep_large_components
from hir_plugins.initializers.visual_hull import hull_volume, make_scene


@final
class Stereo(Initializer):
    """Depth of every photograph, kept where others confirm it; a surface of hull and depths, or of depths alone."""

    def __init__(self, config: StereoOptions) -> None:
        if config.window % 2 == 0 or config.window < 3:
            raise CaptureError(f"initializer.stereo.window is {config.window}; it must be odd, 3 or more")
        self._config = config

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture with dense oriented points, and a mesh. Captures without cameras are a `CaptureError`."""
        del scene, workspace
        cameras = capture.cameras
        if len(cameras) < 3:
            raise CaptureError(f"{capture.path}: stereo needs at least three photographs, there are {len(cameras)}")
        masked = sum(view.pixels().mask is not None for view in capture.views)
        use_hull = self._config.surface == "hull" or (self._config.surface == "auto" and masked >= 2)
        volume = hull_volume(capture, VisualHullOptions()) if use_hull else None
        center, radius = _ball_of(volume) if volume is not None else object_ball(capture)
        measured = measure(capture, center, radius, self._config)
        if measured.points is None:
            raise StageError("stereo measured no depth that photographs agree on; the object may have too little "
                             "texture, or the photographs too little overlap")
        capture = replace(capture, points=measured.points)
        if volume is not None:
            pixel = measured.pixel
            reach = max(12 * pixel, 4 * volume.spacing)
            fused = fuse_into(volume, measured.maps, reach, min_weight=8, doubt=pixel)
            positions, faces = keep_large_components(*extract_surface(fused), min_share=0.02)
        else:
            positions, faces = poisson_surface(measured.points, PoissonOptions())
        return capture, make_scene(positions, faces, capture, self._config.vertex_colors)


@dataclass(frozen=True)
class Measured:
    """What stereo saw."""

    maps: list[DepthMap]
    points: OrientedPoints | None
    pixel: float
    """Side of a pixel at the object, in the world."""


def measure(capture: Capture, center: Array, radius: float, options: StereoOptions) -> Measured:
    """Depth maps of all views of what lies in a ball, confirmed by each other, and their fused points."""
    device = options.device
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    views = [view for view in capture.views if view.camera is not None]
    prepared = [_prepare(view, options.max_image_size, center, radius) for view in views]
    stereo = [p[0] for p in prepared]
    chosen = neighbours([s.camera for s in stereo], center, options.neighbours)
    maps: list[DepthMap] = []
    with torch.inference_mode():
        for view, others in zip(stereo, chosen, strict=True):
            if not others:
                maps.append(_empty(view))
                continue
            distance = float(view.camera.world_to_camera[2, :3] @ center + view.camera.world_to_camera[2, 3])
            near, far = max(distance - 1.05 * radius, 0.05 * distance), distance + 1.05 * radius
            rest = [stereo[j] for j in others]
            part = view.cropped(options.window, 2 ** (options.levels - 1))
            maps.append(depth_map(part, rest, near, far, options.planes, options.window, options.levels, device))
    maps = consistent(maps, chosen, options.min_score, options.min_views, options.max_pixels)
    pixel = float(np.median([np.linalg.norm(s.camera.center - center) / s.camera.intrinsics[0, 0] for s in stereo]))
    colors = [_cut_out(p[1], view, part) for p, view, part in zip(prepared, stereo, maps, strict=True)]
    return Measured(maps, oriented_points(maps, colors, 1.5 * pixel), pixel)


def _cut_out(image: NDArray[np.float32], whole: StereoView, part: DepthMap) -> NDArray[np.float32]:
    """The pixels of a picture that a depth map of a part of it has."""
    left, top = np.rint(whole.camera.intrinsics[:2, 2] - part.camera.intrinsics[:2, 2]).astype(int)
    return image[top : top + part.camera.height, left : left + part.camera.width]


def _prepare(view: View, max_size: int, center: Array, radius: float) -> tuple[StereoView, NDArray[np.float32]]:
    assert view.camera is not None
    factor = max(1, round(max(view.camera.width, view.camera.height) / max_size))
    pixels = view.pixels(factor)
    camera = view.camera.downsampled(factor)
    brightness = linear_to_srgb(np.clip(pixels.color_linear.mean(axis=2), 0, 1)).astype(np.float32)
    if pixels.mask is not None:
        # the background moves with a turntable, and is black in renders: it must not be compared
        brightness = brightness * pixels.mask
        valid = pixels.mask > 0.5
    else:
        pixel, depth = camera.project(center[None])
        reach = radius * 1.05 * camera.intrinsics[0, 0] / max(float(depth[0]), 1e-9)
        rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
        valid = np.hypot(columns - pixel[0, 0], rows - pixel[0, 1]) < reach
    return StereoView(camera, np.ascontiguousarray(brightness), valid), pixels.color_linear


def _empty(view: StereoView) -> DepthMap:
    nothing = np.zeros(view.image.shape, np.float32)
    return DepthMap(view.camera, nothing, nothing - 1)


def _ball_of(volume: Volume) -> tuple[Array, float]:
    inside = volume.origin + np.argwhere(volume.values > 0) * volume.spacing
    center = (inside.min(axis=0) + inside.max(axis=0)) / 2
    return center, float(np.linalg.norm(inside - center, axis=1).max())

