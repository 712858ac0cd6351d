"""Middlebury multi-view stereo: `*_par.txt` with a line `name K R t` for each image."""

from __future__ import annotations

from pathlib import Path
from typing import final

import numpy as np

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import rigid_transform
from hir_plugins.readers.parsing.capture_paths import find_photo, unique_names
from hir_plugins.readers.parsing.lens_camera import LensCamera, make_view
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.text_files import read_text
from hir_plugins.readers.parsing.upright import upright_rotation


@final
class MiddleburyReader(CaptureReader):
    """The first line is the number of images; every other line is a name and 21 numbers: K and R by rows, then t."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with one *_par.txt."""
        return path.is_dir() and any(path.glob("*_par.txt"))

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Images in the order of the file; OpenCV axes, P = K [R t]; the world is rotated upright."""
        source = next(iter(sorted(path.glob("*_par.txt"))), None)
        if source is None or split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of a Middlebury capture")
        rows = [line.split() for line in read_text(source).splitlines() if line.strip()][1:]
        if not rows or any(len(row) != 22 for row in rows):
            raise CaptureError(f"{source} needs one line with a name and 21 numbers for each image")
        photos = [find_photo(path, row[0], source) for row in rows]
        views, poses = [], []
        for row, photo, name in zip(rows, photos, unique_names(photos, path), strict=True):
            owner = f"{source}, {row[0]!r}"
            try:
                numbers = np.array(row[1:], dtype=np.float64)
            except ValueError:
                raise CaptureError(f"{owner}: the line contains a value that is not a number") from None
            k, rotation, translation = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
            pose = rigid_transform(np.concatenate([rotation, translation[:, None]], axis=1), owner)
            lens = LensCamera(k[0, 0], k[1, 1], k[0, 2], k[1, 2])
            views.append(make_view(name, photo, lens, pose, owner, find_mask(photo, path)))
            poses.append(pose)
        warn_of_mask_names(matches_of(views), path)
        capture = Capture(path=path, views=tuple(views), world_from_source=np.eye(4), reader="middlebury")
        return capture.transformed(upright_rotation(poses))
