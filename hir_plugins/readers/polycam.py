"""Polycam: the raw data export, `keyframes/corrected_cameras` with `keyframes/corrected_images`.

Each JSON file has the pose `t_00 … t_23` (camera to world, ARKit: +Y up, cameras look along −z, metres) and the
intrinsics. `keyframes/depth` has millimetres as 16-bit PNG, `keyframes/confidence` 0, 127 and 255 (the README of
github.com/PolyCam/polyform).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import MeasuredDepth
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.capture_paths import contained_path, find_photo
from hir_plugins.readers.parsing.depth_file import MILLIMETRE, depth_map
from hir_plugins.readers.parsing.json_fields import number_field, read_json
from hir_plugins.readers.parsing.lens_camera import LensCamera
from hir_plugins.readers.parsing.posed_photos import PhotoFinder, PosedPhoto, PosedPhotosReader

_FOLDERS: Final = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
_INTRINSICS: Final = ("fx", "fy", "cx", "cy", "width", "height")


@final
class PolycamReader(PosedPhotosReader[tuple[Path, str]]):
    """Corrected cameras if there are any; those of the recording drift."""

    name = "polycam"
    remedy = "no keyframes/cameras; export the raw data of Polycam into this folder"
    is_upright = True
    metres_from = "ARKit"

    def find(self, path: Path) -> tuple[Path, str] | None:
        """The folder of the cameras, and the name of that of the images."""
        for cameras, images in _FOLDERS:
            folder = path / "keyframes" / cameras
            if folder.is_dir() and next(folder.glob("[!.]*.json"), None) is not None:
                return folder, images
        return None

    def cameras(self, source: tuple[Path, str], finder: PhotoFinder) -> list[PosedPhoto]:
        """In the order of the time stamps."""
        cameras_folder, images = source
        cameras = []
        for file in sorted(cameras_folder.glob("[!.]*.json"), key=lambda f: (len(f.stem), f.stem)):
            table = read_json(file)
            owner = str(file)
            values = {key: number_field(table, key, owner) for key in _INTRINSICS}
            values |= {
                f"t_{row}{column}": number_field(table, f"t_{row}{column}", owner)
                for row in range(3)
                for column in range(4)
            }
            missing = [key for key, value in values.items() if value is None]
            if missing:
                raise CaptureError(f"{owner} has no {missing[0]!r}; export the raw data again")
            known = {key: float(value or 0.0) for key, value in values.items()}
            pose = rigid_transform(np.array([[known[f"t_{r}{c}"] for c in range(4)] for r in range(3)]), owner)
            fx, fy, cx, cy, width, height = (known[key] for key in _INTRINSICS)
            lens = LensCamera(fx, fy, cx, cy, width, height)
            # depth maps and uncorrected images have the same names
            photo = find_photo(finder.capture, f"keyframes/{images}/{file.stem}", file)
            name = photo.relative_to(finder.capture).as_posix()
            depth = depth_beside(finder.capture, file.stem)
            cameras.append(PosedPhoto(name, owner, lens, OPENCV_FROM_OPENGL @ rigid_inverse(pose), depth, photo))
        return cameras


def depth_beside(capture: Path, keyframe: str) -> MeasuredDepth | None:
    """The depth map of a keyframe; None where the device has no sensor."""
    depth, confidence = (
        contained_path(capture, f"keyframes/{kind}/{keyframe}.png", capture) for kind in ("depth", "confidence")
    )
    return depth_map(depth, confidence if confidence.is_file() else None, MILLIMETRE) if depth.is_file() else None
