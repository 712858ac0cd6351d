"""Bundle adjustment as a candidate of the camera refinement, judged by held-out tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hir_core.capture import Array, Camera, Capture
from hir_plugins.initializers.options import CameraRefinementOptions, ColmapOptions
from hir_plugins.initializers.refinement.camera_alignment import aligned_cameras
from hir_plugins.initializers.sfm.bundle_adjustment import AdjustedCameras, Track, adjust_bundle, track_errors
from hir_plugins.initializers.sfm.sfm_images import write_images

MIN_TRACKS = 30
"""Held-out tracks below which nothing is decided by them."""
MIN_ADJUSTED_SHARE = 0.9
"""Of the photographs that must see enough points."""
MAX_ERROR_RATIO = 0.9
"""Median error of held-out tracks, relative to the cameras that the adjustment started from, below which it is kept."""
MAX_FOCAL_ERROR_RATIO = 0.97
"""The same for a change of the focal length, relative to the adjustment without it."""
_MAX_EXHAUSTIVE_VIEWS = 80


@dataclass(frozen=True)
class AdjustedBundle:
    """Adjusted cameras in the given world, and the errors of held-out tracks."""

    cameras: tuple[Camera, ...]
    adjusted: int
    points: int
    tracks: int
    error_before: float
    """Median over held-out tracks, in pixels of the photographs, with the cameras that the adjustment started from."""
    error_after: float
    focal_ratio: float
    """Median of new over given focal lengths."""

    @property
    def better(self) -> bool:
        """Whether nearly all cameras were adjusted, and held-out tracks fit clearly better."""
        return (
            self.tracks >= MIN_TRACKS
            and self.adjusted >= MIN_ADJUSTED_SHARE * len(self.cameras)
            and self.error_after < MAX_ERROR_RATIO * self.error_before
        )

    def document(self) -> dict[str, float | int]:
        """For run.json."""
        return {
            "adjusted_cameras": self.adjusted,
            "points": self.points,
            "held_out_tracks": self.tracks,
            "held_out_error_pixels_before": round(self.error_before, 4),
            "held_out_error_pixels_after": round(self.error_after, 4),
            "focal_length_ratio": round(self.focal_ratio, 5),
        }


def adjusted_bundle(
    capture: Capture,
    start: Sequence[Camera],
    focus: Array,
    workspace: Path,
    config: CameraRefinementOptions,
) -> AdjustedBundle | None:
    """The bundle adjustment that starts at `start`; None where too few features match."""
    views = capture.views
    images, masked = write_images(views, workspace, config.max_image_size, known=True)
    options = ColmapOptions(
        max_image_size=config.max_image_size,
        matching="exhaustive" if len(views) <= _MAX_EXHAUSTIVE_VIEWS else "vocabulary",
        threads=config.threads,
        seed=config.seed,
    )
    plain = adjust_bundle(images, start, masked, workspace, options, refine_focal=False)
    if plain is None:
        return None
    best, focal_ratio = plain, 1.0
    # photographs with a lens were undistorted with the given focal length
    if config.focal_length == "auto" and not any(any(view.distortion) for view in views):
        freed = adjust_bundle(images, start, masked, workspace, options, refine_focal=True)
        if freed is not None and _median(freed, plain.held_out) < MAX_FOCAL_ERROR_RATIO * _median(
            plain, plain.held_out
        ):
            best = freed
            focal_ratio = float(
                np.median([a.intrinsics[0, 0] / b.intrinsics[0, 0] for a, b in zip(freed.cameras, start, strict=True)])
            )
    return AdjustedBundle(
        tuple(aligned_cameras(best.cameras, capture.cameras, focus)),
        best.adjusted,
        best.points,
        len(best.held_out),
        float(np.median(track_errors(best.held_out, start))) if best.held_out else np.inf,
        _median(best, best.held_out),
        focal_ratio,
    )


def _median(adjusted: AdjustedCameras, tracks: Sequence[Track]) -> float:
    return float(np.median(track_errors(tracks, adjusted.cameras))) if tracks else np.inf
