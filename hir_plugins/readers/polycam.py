"""Polycam: the raw data export, `keyframes/corrected_cameras` with `keyframes/corrected_images`.

Each JSON file has the pose `t_00 … t_23` (camera to world, ARKit: +Y up, cameras look along −z, metres) and the
intrinsics.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.json_fields import number_field, read_json
from hir_plugins.readers.parsing.lens_camera import LensCamera
from hir_plugins.readers.parsing.posed_photos import PosedPhoto, posed_capture, refuse_split

_FOLDERS: Final = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
_INTRINSICS: Final = ("fx", "fy", "cx", "cy", "width", "height")


@final
class PolycamReader(CaptureReader):
    """Corrected cameras if there are any; those of the recording drift."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with `keyframes` and cameras in it."""
        return path.is_dir() and _folders(path) is not None

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Photographs in the order of their time stamps; ARKit's +Y up and metres are kept."""
        refuse_split(path, split)
        folders = _folders(path)
        if folders is None:
            raise CaptureError(f"{path} has no keyframes/cameras; export the raw data of Polycam into this folder")
        cameras_folder, images = folders
        cameras = []
        for file in sorted(cameras_folder.glob("*.json"), key=lambda f: (len(f.stem), f.stem)):
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
            name = f"keyframes/{images}/{file.stem}"
            cameras.append(PosedPhoto(name, owner, lens, OPENCV_FROM_OPENGL @ rigid_inverse(pose)))
        return posed_capture(path, "polycam", cameras, np.eye(4))


def _folders(path: Path) -> tuple[Path, str] | None:
    for cameras, images in _FOLDERS:
        folder = path / "keyframes" / cameras
        if folder.is_dir() and next(folder.glob("*.json"), None) is not None:
            return folder, images
    return None
