"""A view from the intrinsics, the lens and the pose in a capture's file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from hir_core.capture import Array, Camera, MeasuredDepth, View
from hir_core.capture.lens import camera_lens, fisheye_lens
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import MAX_DISTANCE, camera_matrix
from hir_plugins.readers.parsing.decoding.photo_file import PhotoFile
from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size

MAX_SIDES = 1e4
"""Largest focal length, and largest distance of the principal point, in sides of the image: 0.006° across."""

HALF_PIXEL = 0.5
"""Added to principal points of formats that have pixel centres at integers: ours are at .5."""


@dataclass(frozen=True)
class LensCamera:
    """Intrinsics and lens of a camera in a file, for images of `width` × `height`; 0 if the file has no size."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: float = 0
    height: float = 0
    coefficients: tuple[float, ...] = ()
    model: Literal["radial", "fisheye"] = "radial"


def pinhole_camera(lens: LensCamera, world_to_camera: Array, width: int, height: int, owner: str) -> Camera:
    """The camera of an image without distortion; its intrinsics and errors are those of `make_view`."""
    _check_distance(world_to_camera, owner)
    return Camera(camera_matrix(*_intrinsics(lens, width, height, owner)), world_to_camera, width, height)


def make_view(
    name: str,
    photo: Path,
    lens: LensCamera,
    world_to_camera: Array,
    owner: str,
    mask: Path | None = None,
    depth: MeasuredDepth | None = None,
) -> View:
    """The view of `photo`; intrinsics are scaled if the file is for a larger or smaller image.

    An image of another aspect ratio, and impossible intrinsics, raise a `CaptureError` that names `owner`.
    """
    width, height = photo_size(photo)
    orient = False
    if (lens.width, lens.height) == (height, width) and width != height:
        # the camera was estimated on the image in display orientation
        turned = photo_size(photo, orient=True)
        orient, (width, height) = turned == (lens.width, lens.height), turned
    numbers = _intrinsics(lens, width, height, owner)
    _check_distance(world_to_camera, owner)
    fisheye = None
    try:
        if lens.model == "fisheye":
            fisheye = fisheye_lens(numbers, lens.coefficients, width, height)
            numbers = fisheye.pinhole
        distortion = lens.coefficients if lens.model == "radial" and any(lens.coefficients) else ()
        camera = Camera(camera_matrix(*numbers), world_to_camera, width, height)
        camera_lens(camera, distortion)
    except CaptureError as error:
        raise CaptureError(f"{owner}: {error}") from None
    read = PhotoFile(photo, mask, orient=orient, lens=fisheye, width=width, height=height)
    if depth is not None and orient:
        raise CaptureError(
            f"{owner}: a photograph that its EXIF data rotates has no depth map; rotate both in their files"
        )
    depth = None if depth is None else replace(depth, lens=fisheye)
    return View(name, camera, read, distortion=distortion, path=photo, mask_path=mask, depth=depth)


def _intrinsics(lens: LensCamera, width: int, height: int, owner: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of an image of `width` × `height`."""
    named_width, named_height = lens.width or width, lens.height or height
    scale_x, scale_y = width / named_width, height / named_height
    if not 0.98 < scale_x / scale_y < 1.02:
        raise CaptureError(
            f"{owner}: the image is {width}×{height}, but the camera is for {named_width:g}×{named_height:g}; use the "
            "images that the cameras were estimated with, neither cropped nor rotated"
        )
    numbers = (lens.fx * scale_x, lens.fy * scale_y, lens.cx * scale_x, lens.cy * scale_y)
    largest = MAX_SIDES * max(width, height)
    if not (np.abs(numbers) <= largest).all() or numbers[0] <= 0 or numbers[1] <= 0:  # also of NaN
        raise CaptureError(
            f"{owner}: the focal length {lens.fx:g}, {lens.fy:g} or the centre {lens.cx:g}, {lens.cy:g} is not "
            "possible; export the cameras again"
        )
    return numbers


def _check_distance(world_to_camera: Array, owner: str) -> None:
    if not (np.abs(world_to_camera) <= MAX_DISTANCE).all():  # also of NaN
        raise CaptureError(
            f"{owner}: the camera is more than {MAX_DISTANCE:g} units from the origin; export the cameras again"
        )
