"""A view of a photograph from the intrinsics, lens and pose that a capture's file states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from hir_core.capture import Array, Camera, View
from hir_core.capture.lens import camera_lens, fisheye_lens
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import camera_matrix
from hir_plugins.readers.parsing.photo_file import PhotoFile
from hir_plugins.readers.parsing.picture_decoding import photo_size


@dataclass(frozen=True)
class LensCamera:
    """A camera as files describe it, for a picture of `width` × `height`, 0 where the file does not say."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: float = 0
    height: float = 0
    coefficients: tuple[float, ...] = ()
    model: Literal["radial", "fisheye"] = "radial"


def make_view(
    name: str, photo: Path, lens: LensCamera, world_to_camera: Array, owner: str, mask: Path | None = None
) -> View:
    """The view of `photo`, its intrinsics scaled where the file speaks of a larger or smaller picture.

    A picture of another shape, which was cropped or turned, and impossible intrinsics are a `CaptureError` of `owner`.
    """
    width, height = photo_size(photo)
    orient = False
    if (lens.width, lens.height) == (height, width) and width != height:
        # the camera was solved on the picture turned upright
        turned = photo_size(photo, orient=True)
        orient, (width, height) = turned == (lens.width, lens.height), turned
    named_width, named_height = lens.width or width, lens.height or height
    scale_x, scale_y = width / named_width, height / named_height
    if not 0.98 < scale_x / scale_y < 1.02:
        raise CaptureError(
            f"{owner}: the image is {width}×{height}, the camera's {named_width:g}×{named_height:g}: "
            "they differ in shape, so the image was cropped or turned"
        )
    numbers = (lens.fx * scale_x, lens.fy * scale_y, lens.cx * scale_x, lens.cy * scale_y)
    if not np.isfinite(numbers).all() or numbers[0] <= 0 or numbers[1] <= 0:
        raise CaptureError(
            f"{owner}: the focal length {lens.fx:g}, {lens.fy:g} and centre {lens.cx:g}, {lens.cy:g} "
            "are not those of a camera"
        )
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
    return View(name=name, camera=camera, read=read, distortion=distortion, path=photo, mask_path=mask)
