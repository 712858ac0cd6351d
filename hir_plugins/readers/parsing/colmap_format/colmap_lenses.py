"""COLMAP's camera models as `LensCamera`."""

from __future__ import annotations

import math
from typing import Final

from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.lens_camera import LensCamera

# id, name, number of parameters
_MODELS: Final = (
    (0, "SIMPLE_PINHOLE", 3),
    (1, "PINHOLE", 4),
    (2, "SIMPLE_RADIAL", 4),
    (3, "RADIAL", 5),
    (4, "OPENCV", 8),
    (5, "OPENCV_FISHEYE", 8),
    (6, "FULL_OPENCV", 12),
    (7, "FOV", 5),
    (8, "SIMPLE_RADIAL_FISHEYE", 4),
    (9, "RADIAL_FISHEYE", 5),
    (10, "THIN_PRISM_FISHEYE", 12),
)


def lens_camera(
    model: str, parameters: tuple[float, ...] | list[float], width: int, height: int, owner: str
) -> LensCamera:
    """A camera from COLMAP's model name and parameters; models without an OpenCV lens raise `CaptureError`."""
    p = tuple(float(value) for value in parameters)
    sizes = {name: size for _, name, size in _MODELS}
    if model not in sizes or len(p) != sizes[model]:
        raise CaptureError(f"{owner}: the camera model {model!r} with {len(p)} parameters is unknown")
    if not all(math.isfinite(value) for value in p):
        raise CaptureError(f"{owner}: a camera has parameters that are NaN or infinite; export the model again")
    if not 0 < width < 1 << 20 or not 0 < height < 1 << 20:
        raise CaptureError(f"{owner}: a camera has images of {width}×{height} pixels; export the model again")
    match model:
        case "SIMPLE_PINHOLE":
            return LensCamera(p[0], p[0], p[1], p[2], width, height)
        case "PINHOLE":
            return LensCamera(p[0], p[1], p[2], p[3], width, height)
        case "SIMPLE_RADIAL" | "RADIAL":
            return LensCamera(p[0], p[0], p[1], p[2], width, height, (*p[3:], 0.0, 0.0, 0.0)[:4])
        case "OPENCV" | "FULL_OPENCV":
            return LensCamera(p[0], p[1], p[2], p[3], width, height, p[4:])
        case "OPENCV_FISHEYE":
            return LensCamera(p[0], p[1], p[2], p[3], width, height, p[4:], "fisheye")
        case "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE":
            return LensCamera(p[0], p[0], p[1], p[2], width, height, (*p[3:], 0.0, 0.0, 0.0)[:4], "fisheye")
        case _:
            raise CaptureError(
                f"{owner}: the camera model {model} is not supported; undistort the images with colmap "
                "image_undistorter "
                "and give its result"
            )
