"""Bundler: `bundle.out` and its list of images.

Cameras look along −z with y up, and pixels are counted from the middle of the image with y up (Bundler v0.3, user
manual).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import final

import numpy as np

from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_transform
from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size
from hir_plugins.readers.parsing.lens_camera import LensCamera
from hir_plugins.readers.parsing.posed_photos import PhotoFinder, PosedPhoto, PosedPhotosReader
from hir_plugins.readers.parsing.text_files import file_head, read_text

_HEADER = b"# Bundle file"


@final
class BundlerReader(PosedPhotosReader[Path]):
    """Five lines a camera: focal length and two radial coefficients, the rotation, the translation."""

    name = "bundler"
    remedy = "no bundle file; put bundle.out and its list of images into this folder"

    def find(self, path: Path) -> Path | None:
        """The bundle file."""
        usual = [path / "bundle.out", path / "bundle" / "bundle.out", *sorted(path.glob("*.out"))[:20]]
        return next((file for file in usual if file_head(file).startswith(_HEADER)), None)

    def cameras(self, source: Path, finder: PhotoFinder) -> list[PosedPhoto]:
        """Those that are registered."""
        blocks = _blocks(source)
        names = _names(finder.capture, source, len(blocks))
        cameras = []
        for name, block in zip(names, blocks, strict=True):
            owner = f"{source}, {name!r}"
            focal, k1, k2 = block[0]
            if focal == 0:  # not registered
                continue
            pose = np.concatenate([block[1:4], block[4][:, None]], axis=1)
            width, height = photo_size(finder.find(name, owner))
            lens = LensCamera(focal, focal, width / 2, height / 2, width, height, (k1, k2, 0.0, 0.0))
            cameras.append(PosedPhoto(name, owner, lens, OPENCV_FROM_OPENGL @ rigid_transform(pose, owner)))
        return cameras


def _blocks(source: Path) -> np.ndarray:
    """(N, 5, 3): the five lines of each camera."""
    lines = read_text(source).splitlines()[1:]
    try:
        count = int(lines[0].split()[0])
        rows = [[float(word) for word in line.split()] for line in lines[1 : 1 + 5 * count]]
        blocks = np.array(rows, dtype=np.float64).reshape(count, 5, 3)
    except (ValueError, IndexError, OverflowError, MemoryError):
        raise CaptureError(f"{source} needs five lines of three numbers for each camera; export it again") from None
    if not np.isfinite(blocks).all():
        raise CaptureError(f"{source} contains NaN or infinite values; export the cameras again")
    return blocks


def _names(path: Path, source: Path, count: int) -> list[str]:
    lists = [folder / "list.txt" for folder in (source.parent, path)] + sorted(path.glob("*list*.txt"))[:20]
    for file in dict.fromkeys(lists):
        if file.is_file():
            lines = [line.strip() for line in read_text(file).splitlines() if line.strip()]
            names = [_without_focal_length(line) for line in lines]
            if len(names) == count:
                return names
    raise CaptureError(f"{source} has {count} cameras; put list.txt with the names of as many images beside it")


def _without_focal_length(line: str) -> str:
    """The name of an image; its line may end with a zero and the focal length from EXIF: "a.jpg 0 2844.4"."""
    words = line.rsplit(maxsplit=2)
    if len(words) == 3 and words[1] == "0" and re.fullmatch(r"[-+.\deE]+", words[2]):
        return words[0]
    words = line.rsplit(maxsplit=1)
    return words[0] if len(words) == 2 and words[1] == "0" else line
