"""The metric scale of a structure-from-motion result: from a scale bar, or from GPS positions of the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from hir_exporters.files.regular_files import refuse_special_file

from hir_core.capture import Array, Camera, View
from hir_core.capture.exif import gps_position
from hir_core.errors import CaptureError

_MIN_POSITIONS = 5
_MAX_RELATIVE_ERROR = 0.05
"""Largest relative standard error of a scale from GPS that is used."""
_OUTLIER_METRES = 15.0
"""GPS positions farther than this from the best fit are treated as receiver errors."""


@dataclass(frozen=True)
class MetricScale:
    """Scale of the world."""

    metres_per_unit: float
    source: str
    """Where the scale comes from, for the report."""


@dataclass(frozen=True)
class ScaleBarMark:
    """One end of a scale bar in one photograph."""

    view: str
    end: str
    pixel: tuple[float, float]


def read_marks(path: Path) -> list[ScaleBarMark]:
    """Marks of a scale bar; an invalid line raises `CaptureError` with its number."""
    try:
        refuse_special_file(path)
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(
            f"{path} cannot be read: {error}; set initializer.colmap.scale_bar to a text file with lines like "
            "`IMG_0012 a 811.5 402`"
        ) from error
    marks = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        # names of photographs may contain spaces
        try:
            name, end, x, y = line.rsplit(maxsplit=3)
            pixel = float(x), float(y)
        except ValueError:
            end = ""
        if end not in ("a", "b") or not np.isfinite(pixel).all():
            raise CaptureError(
                f"{path}, line {number}: {line.strip()[:60]!r} is not `photograph end x y`; end is a or b, x and y are "
                "pixels"
            )
        marks.append(ScaleBarMark(Path(name).stem if Path(name).suffix else name, end, pixel))
    return marks


def scale_of_bar(marks: Sequence[ScaleBarMark], length: float, views: Sequence[View]) -> MetricScale:
    """The scale from the distance of the triangulated ends. Ends that cannot be triangulated raise `CaptureError`."""
    if length <= 0:
        raise CaptureError(
            "initializer.colmap.scale_bar_length is missing; set it to the distance of the bar's ends in metres"
        )
    cameras = {Path(view.name).stem: view for view in views if view.camera is not None}
    takes = sorted({cameras[mark.view].take for mark in marks if mark.view in cameras})
    if len(takes) > 1:
        raise CaptureError(
            f"the scale bar is marked in photographs of the takes {', '.join(takes)}, between which it moved against "
            "the object; mark it in those of one take"
        )
    ends = []
    for end in ("a", "b"):
        rays = [_ray(cameras[mark.view], mark.pixel) for mark in marks if mark.end == end and mark.view in cameras]
        if len(rays) < 2:
            raise CaptureError(
                f"the scale bar's end {end} is marked in {len(rays)} photographs with a camera; mark it in two or more "
                "from different sides"
            )
        ends.append(_closest_point(rays, end))
    distance = float(np.linalg.norm(ends[0] - ends[1]))
    if distance <= 0:
        raise CaptureError("both ends of the scale bar are marked at the same point; mark its two ends")
    return MetricScale(length / distance, f"scale bar of {length:g} m")


def scale_of_gps(views: Sequence[View], seed: int = 0) -> MetricScale | None:
    """The scale from the photographs' GPS positions; None if there are too few or its error is above 5 %."""
    pairs = [
        (view.camera.center, position)
        for view in views
        if view.camera is not None and view.path is not None and (position := gps_position(view.path)) is not None
    ]
    if len(pairs) < _MIN_POSITIONS:
        return None
    centers = np.array([center for center, _ in pairs])
    globe = np.array([position for _, position in pairs])
    metres = pycolmap.GPSTransform().ellipsoid_to_enu(globe, *np.median(globe, axis=0))
    options = pycolmap.RANSACOptions()
    options.max_error = _OUTLIER_METRES
    options.random_seed = seed
    # pycolmap returns a dict here, not the Sim3d of its stubs
    fit: Any = pycolmap.estimate_sim3d_robust(centers, metres, options)
    if fit is None:
        return None
    similarity = fit["tgt_from_src"].matrix()
    fitted = centers @ similarity[:, :3].T + similarity[:, 3]
    residual = np.linalg.norm(fitted - metres, axis=1)
    inlier = residual < _OUTLIER_METRES
    if inlier.sum() < _MIN_POSITIONS:
        return None
    extent = np.sqrt(((fitted[inlier] - fitted[inlier].mean(axis=0)) ** 2).sum())
    # the scale is a regression coefficient: its error is the residuals' over the root of the summed squared positions
    error = float(np.sqrt((residual[inlier] ** 2).sum() / (3 * inlier.sum() - 7)) / max(extent, 1e-12))
    if not error <= _MAX_RELATIVE_ERROR:
        return None
    metres_per_unit = float(np.linalg.norm(similarity[:, 0]))
    return MetricScale(metres_per_unit, f"GPS of {int(inlier.sum())} photographs, to {error:.1%}")


def _ray(view: View, pixel: tuple[float, float]) -> tuple[Array, Array]:
    camera = view.camera
    assert camera is not None
    origin, direction = camera.rays(np.array([_undistorted(pixel, camera, view.distortion)]))
    return np.asarray(origin).reshape(-1, 3)[0], np.asarray(direction).reshape(-1, 3)[0]


def _undistorted(pixel: tuple[float, float], camera: Camera, distortion: Sequence[float]) -> Array:
    """Pixel of the undistorted photograph; marks are made in the photograph as taken."""
    import cv2

    if not any(distortion):
        return np.asarray(pixel, dtype=np.float64)
    k = camera.intrinsics
    coefficients = np.zeros(8)
    coefficients[: len(distortion)] = distortion
    point = cv2.undistortPoints(np.array([[pixel]], dtype=np.float64), k, coefficients, P=k)
    return np.asarray(point, dtype=np.float64).reshape(-1)


def _closest_point(rays: Sequence[tuple[Array, Array]], end: str) -> Array:
    """The point nearest to all rays (least squares)."""
    across = [np.eye(3) - np.outer(d, d) / (d @ d) for _, d in rays]
    normal = np.sum(across, axis=0)
    if np.linalg.eigvalsh(normal)[0] < 1e-4 * len(rays):
        raise CaptureError(
            f"the photographs that mark the scale bar's end {end} are from the same side; mark it also from another "
            "side"
        )
    return np.asarray(np.linalg.solve(normal, np.sum([a @ o for a, (o, _) in zip(across, rays, strict=True)], axis=0)))
