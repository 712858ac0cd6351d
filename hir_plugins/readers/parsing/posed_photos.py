"""Photographs with cameras that another program estimated: finds their files and makes the capture."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Generic, TypeVar, final

import numpy as np

from hir_core.capture import Array, Capture, MeasuredDepth
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.capture_paths import contained_path, is_photo_name, unique_names
from hir_plugins.readers.parsing.lens_camera import LensCamera, make_view
from hir_plugins.readers.parsing.mask_files import FOLDERS as MASK_FOLDERS
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.takes_file import with_takes
from hir_plugins.readers.parsing.upright import upright_rotation_of

Source = TypeVar("Source")

MAX_DEPTH = 4
"""Folders below the capture in which photographs are looked for."""

MAX_FILES = 200_000
"""Files of a capture's folder that are listed."""


@dataclass(frozen=True, eq=False)
class PosedPhoto:
    """One camera of the file."""

    name: str
    """The photograph as the file names it: a label, a file name or a path on another computer."""
    owner: str
    """The file and the entry, for messages."""
    lens: LensCamera
    world_to_camera: Array
    """4×4, OpenCV axes."""
    depth: MeasuredDepth | None = None
    photo: Path | None = None
    """The file of the photograph, where the format says which it is; None looks for the name."""


class PhotoFinder:
    """Finds photographs below a folder by name, because other programs store paths of the computer they ran on."""

    def __init__(self, capture: Path) -> None:
        self.capture = capture
        self._by_name: dict[str, list[Path]] = defaultdict(list)
        for path in _photos(capture):
            for name in {path.name.lower(), path.stem.lower()}:
                self._by_name[name].append(path)

    def find(self, name: str, owner: str) -> Path:
        """The file of that name, with or without suffix; of several, the one whose folders agree with the name's."""
        parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
        last = parts[-1].lower() if parts else ""
        found = self._by_name.get(last, [])
        if not found:
            raise CaptureError(
                f"{owner} names the image {name!r}, which is not in {self.capture}; add the file or remove its entry"
            )
        agreements = [_common_folders(path, parts) for path in found]
        best = [path for path, agreement in zip(found, agreements, strict=True) if agreement == max(agreements)]
        if len(best) > 1:
            raise CaptureError(
                f"{owner}: the image {name!r} may be {best[0]} or {best[1]}; keep only one of them in {self.capture}"
            )
        return contained_path(self.capture, best[0].relative_to(self.capture).as_posix(), self.capture)


class PosedPhotosReader(CaptureReader, Generic[Source]):
    """A format whose files list photographs with poses; it has the split "train" alone."""

    name: ClassVar[str]
    """The reader's."""
    remedy: ClassVar[str]
    """What a folder lacks that is not of the format, and what to put into it."""
    is_upright: ClassVar[bool] = False
    """Whether the file's world has +Y up; otherwise the world is rotated upright by the cameras."""
    metres_from: ClassVar[str] = ""
    """What measured the metres of every file's world; empty where that is unknown, or differs by file."""

    def __init__(self, config: NoOptions) -> None:
        del config

    @abstractmethod
    def find(self, path: Path) -> Source | None:
        """The file of the cameras in a folder, or whatever says where they are; None if there is none."""

    @abstractmethod
    def cameras(self, source: Source, finder: PhotoFinder) -> list[PosedPhoto]:
        """The photographs that have a pose, in the order of the file; `finder` knows the capture's folder."""

    def metres_source(self, source: Source) -> str:
        """What measured the metres of the cameras in `source`; empty where their unit is unknown."""
        del source
        return self.metres_from

    @final
    def matches(self, path: Path) -> bool:
        """A folder in which `find` finds something."""
        return path.is_dir() and self.find(path) is not None

    @final
    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    @final
    def read(self, path: Path, split: str = "train") -> Capture:
        """The photographs that have a pose; a photograph that is missing is an error."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of these cameras")
        source = self.find(path)
        if source is None:
            raise CaptureError(f"{path} has {self.remedy}")
        finder = PhotoFinder(path)
        cameras = self.cameras(source, finder)
        if not cameras:
            raise CaptureError(
                f"{path} has no photograph with a camera; align the photographs and export the cameras again"
            )
        photos = [camera.photo or finder.find(camera.name, camera.owner) for camera in cameras]
        owners: dict[Path, str] = {}
        for camera, photo in zip(cameras, photos, strict=True):
            if photo in owners:
                raise CaptureError(
                    f"{camera.owner} and {owners[photo]} have the same photograph, {photo}; give photographs of "
                    "different folders different names, align them again and export the cameras"
                )
            owners[photo] = camera.owner
        views = [
            make_view(
                *(name, photo, camera.lens, camera.world_to_camera, camera.owner),
                mask=find_mask(photo, path),
                depth=camera.depth,
            )
            for camera, photo, name in zip(cameras, photos, unique_names(photos, path), strict=True)
        ]
        warn_of_mask_names(matches_of(views), path)
        capture = Capture(path, with_takes(views, path), reader=self.name, metres_from=self.metres_source(source))
        upright = np.eye(4) if self.is_upright else upright_rotation_of(capture.views)
        return capture.transformed(upright)


def _photos(capture: Path) -> list[Path]:
    found: list[Path] = []
    listed = 0
    for folder, subfolders, files in os.walk(capture):
        depth = len(Path(folder).relative_to(capture).parts)
        keep = sorted(s for s in subfolders if s not in MASK_FOLDERS and not s.startswith(".") and depth < MAX_DEPTH)
        subfolders[:] = [s for s in keep if not s.endswith(("_mask", "_masks"))]
        listed += len(files)
        if listed > MAX_FILES:
            raise CaptureError(f"{capture} has more than {MAX_FILES} files; give the capture a folder of its own")
        found += [Path(folder) / file for file in sorted(files) if is_photo_name(file)]
    return found


def _common_folders(path: Path, parts: Sequence[str]) -> int:
    """Number of folders, from the last, that a file and a name have in common."""
    count = 0
    for own, named in zip(reversed(path.parts[:-1]), reversed(parts[:-1]), strict=False):
        if own.lower() != named.lower():
            break
        count += 1
    return count
