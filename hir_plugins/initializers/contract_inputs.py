"""Inputs for the contract tests of initializers (`Component.testing`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hir_core.capture import Camera, Capture, DepthPixels, MeasuredDepth

if TYPE_CHECKING:
    from hir_core.testing.captures import TinyCapture


def object_mesh_file(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """The true surface as a file, in the axes of the capture's own files."""
    import trimesh

    from hir_core.testing.captures import BALLS

    del truth
    balls = [trimesh.creation.icosphere(3, radius).apply_translation(centre) for centre, radius in BALLS]
    # the balls intersect: the part of each that lies inside the other is not surface
    outer_parts = []
    for ball, (centre, radius) in zip(balls, reversed(BALLS), strict=True):
        outside = ((ball.triangles_center - centre) ** 2).sum(axis=1) > radius**2
        outer_parts.append(ball.submesh([outside.nonzero()[0]], append=True))
    trimesh.util.concatenate(outer_parts).export(folder / "object.ply")
    return capture, {"path": str(folder / "object.ply"), "axes": "source"}


def without_masks(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """Photographs, cameras and oriented points without masks."""
    del capture, folder
    return truth.without_masks(), {}


def with_depth_maps(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """The capture with the true depths of its object, at half its resolution."""
    del truth, folder
    views = [replace(view, depth=MeasuredDepth(_ball_depth(view.camera.downsampled(2)))) for view in capture.views]  # type: ignore[union-attr]
    return replace(capture, views=tuple(views)), {}


@dataclass(frozen=True)
class _StoredDepth:
    """Depths in memory; picklable."""

    pixels: DepthPixels

    def __call__(self) -> DepthPixels:
        return self.pixels


def _ball_depth(camera: Camera) -> _StoredDepth:
    """Depth along the optical axis of the true surface, 0 beside it."""
    from hir_core.testing.captures import BALLS

    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    origin, direction = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    reach = np.full(len(origin), np.inf)
    for centre, radius in BALLS:
        offset = origin - centre
        half = (offset * direction).sum(axis=1)
        root = half**2 - (offset**2).sum(axis=1) + radius**2
        hit = root > 0
        reach[hit] = np.minimum(reach[hit], -half[hit] - np.sqrt(root[hit]))
    seen = np.isfinite(reach)
    depth = np.where(seen, np.where(seen, reach, 0) * (direction @ camera.world_to_camera[2, :3]), 0)
    shape = (camera.height, camera.width)
    return _StoredDepth(DepthPixels(depth.reshape(shape).astype(np.float32), seen.reshape(shape).astype(np.float32)))


def with_markers(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """Larger photographs from the same places, of a sheet of printed markers."""
    from hir_plugins.initializers.markers.marker_sheet import MarkerSheet
    from hir_plugins.initializers.markers.marker_views import marker_capture

    del capture
    cameras = [larger(camera, 4) for camera in truth.capture.cameras]
    sheet = MarkerSheet(columns=3, rows=3, side=0.4, pitch=0.7)
    return marker_capture(folder, cameras, sheet), {"side": sheet.side}


def with_color_checker(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """Larger photographs from the same places, of a ColorChecker."""
    from hir_plugins.initializers.color_chart.chart_views import ColorCheckerSheet
    from hir_plugins.initializers.markers.marker_views import marker_capture

    del capture
    cameras = [larger(camera, 4) for camera in truth.capture.cameras]
    return marker_capture(folder, cameras, ColorCheckerSheet(side=0.35)), {}


def larger(camera: Camera, factor: int) -> Camera:
    """The camera with `factor` times as many pixels each way."""
    intrinsics = np.diag([factor, factor, 1.0]) @ camera.intrinsics
    return replace(camera, intrinsics=intrinsics, width=factor * camera.width, height=factor * camera.height)
