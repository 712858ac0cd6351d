"""LLFF captures: `poses_bounds.npy` and a folder of images."""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.capture_paths import photos_in_first_folder, unique_names
from hir_plugins.readers.parsing.lens_camera import LensCamera, make_view
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.pose_files import load_arrays
from hir_plugins.readers.parsing.upright import upright_rotation

_FOLDERS: Final = ("images", "image", "images_4", "images_8", "images_2")


@final
class LlffReader(CaptureReader):
    """Rows of 17 numbers: 3×5 (axes down, right, backwards; position; height, width, focal) and two depth bounds."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with poses_bounds.npy."""
        return (path / "poses_bounds.npy").is_file()

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Images by name, one row each; the world is rotated upright."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of an LLFF capture")
        source = path / "poses_bounds.npy"
        table = load_arrays(source).get("array")
        if table is None or table.ndim != 2 or table.shape[1] != 17 or not len(table):
            raise CaptureError(f"{source} has no rows of 17 numbers; write one row per image")
        photos = photos_in_first_folder(path, _FOLDERS)
        if len(photos) != len(table):
            raise CaptureError(f"{source} has {len(table)} cameras and {path} {len(photos)} images; give one each")
        views, poses = [], []
        for i, (row, photo, name) in enumerate(zip(table, photos, unique_names(photos, path), strict=True)):
            owner = f"{source}, row {i}"
            matrix = row[:15].reshape(3, 5)
            height, width, focal = matrix[:, 4]
            # from columns down, right, backwards to columns right, up, backwards
            axes = np.stack([matrix[:, 1], -matrix[:, 0], matrix[:, 2], matrix[:, 3]], axis=1)
            pose = rigid_inverse(rigid_transform(axes, owner) @ OPENCV_FROM_OPENGL)
            lens = LensCamera(focal, focal, width / 2, height / 2, width, height)
            views.append(make_view(name, photo, lens, pose, owner, find_mask(photo, path)))
            poses.append(pose)
        warn_of_mask_names(matches_of(views), path)
        capture = Capture(path=path, views=tuple(views), world_from_source=np.eye(4), reader="llff")
        return capture.transformed(upright_rotation(poses))
