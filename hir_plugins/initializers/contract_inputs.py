"""Inputs for the contract tests of initializers (`Component.testing`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hir_core.capture import Camera, Capture

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


def with_markers(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """Larger photographs from the same places, of a sheet of printed markers."""
    from hir_plugins.initializers.markers.marker_sheet import MarkerSheet
    from hir_plugins.initializers.markers.marker_views import marker_capture

    del capture
    cameras = [larger(camera, 4) for camera in truth.capture.cameras]
    sheet = MarkerSheet(columns=3, rows=3, side=0.4, pitch=0.7)
    return marker_capture(folder, cameras, sheet), {"side": sheet.side}


def larger(camera: Camera, factor: int) -> Camera:
    """The camera with `factor` times as many pixels each way."""
    intrinsics = np.diag([factor, factor, 1.0]) @ camera.intrinsics
    return replace(camera, intrinsics=intrinsics, width=factor * camera.width, height=factor * camera.height)
