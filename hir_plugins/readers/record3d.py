"""Record3D: `metadata.json` (or `metadata`) beside `rgb/0.jpg, 1.jpg …`, as its export and an unpacked .r3d have them.

`poses` are quaternions (x, y, z, w) and positions of the camera in ARKit's world: +Y up, cameras look along −z, metres.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np
from scipy.spatial.transform import Rotation

from hir_core.capture import Array, Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.json_fields import number_field, read_json
from hir_plugins.readers.parsing.lens_camera import LensCamera
from hir_plugins.readers.parsing.posed_photos import PosedPhoto, posed_capture, refuse_split
from hir_plugins.readers.parsing.xml_files import file_head

_FILES: Final = ("metadata.json", "metadata")
_FOLDERS: Final = ("rgb", "rgbd")
_KEYS: Final = (b'"poses"', b'"K"', b'"perFrameIntrinsicCoeffs"')
"""Keys of the file, one of which is among its first bytes."""


@final
class Record3DReader(CaptureReader):
    """One pose and one photograph a frame."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with such a file that holds poses, and a folder of photographs."""
        return path.is_dir() and _file(path) is not None and _folder(path) is not None

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Frames in their order; ARKit's +Y up and metres are kept."""
        refuse_split(path, split)
        source, folder = _file(path), _folder(path)
        if source is None or folder is None:
            raise CaptureError(f"{path} has no metadata.json with a folder rgb; export the recording of Record3D here")
        content = read_json(source)
        owner = str(source)
        width, height = number_field(content, "w", owner), number_field(content, "h", owner)
        matrix = _rows(content.get("K"), 9, f"{owner}, K")
        poses = content.get("poses")
        if not width or not height or matrix is None or not isinstance(poses, list):
            raise CaptureError(f"{owner} needs 'w', 'h', 'K' with nine numbers, and 'poses'; export it again")
        k = matrix.reshape(3, 3).T  # stored by columns
        frames = content.get("perFrameIntrinsicCoeffs")
        cameras = []
        for i, entry in enumerate(poses):
            row = _rows(entry, 7, f"{owner}, pose {i}")
            if row is None or not 1e-9 < np.linalg.norm(row[:4]) < 1e9:
                raise CaptureError(f"{owner}, pose {i} is not a quaternion and a position; export it again")
            own = _rows(frames[i], 4, f"{owner}, frame {i}") if isinstance(frames, list) and i < len(frames) else None
            fx, fy, cx, cy = (k[0, 0], k[1, 1], k[0, 2], k[1, 2]) if own is None else own
            lens = LensCamera(float(fx), float(fy), float(cx), float(cy), width, height)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = Rotation.from_quat(row[:4]).as_matrix(), row[4:]
            world_to_camera = OPENCV_FROM_OPENGL @ rigid_inverse(rigid_transform(pose, owner))
            cameras.append(PosedPhoto(f"{folder}/{i}", f"{owner}, frame {i}", lens, world_to_camera))
        return posed_capture(path, "record3d", cameras, np.eye(4))


def _file(path: Path) -> Path | None:
    heads = ((path / name, file_head(path / name)) for name in _FILES)
    return next((file for file, head in heads if any(key in head for key in _KEYS)), None)


def _folder(path: Path) -> str | None:
    return next((name for name in _FOLDERS if (path / name).is_dir()), None)


def _rows(value: object, count: int, owner: str) -> Array | None:
    """So many finite numbers; None for anything else."""
    if not isinstance(value, list) or len(value) != count:
        return None
    return np.array([number_field({owner: part}, owner, owner, np.nan) for part in value])
