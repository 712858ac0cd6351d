"""A folder of photographs without cameras, with or without masks."""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path
from typing import Final, final

from hir_core.capture import Capture, View
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.capture_paths import PHOTO_SUFFIXES, contained_path, unique_names
from hir_plugins.readers.parsing.mask_files import find_mask, found_masks, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.photo_file import PhotoFile
from hir_plugins.readers.parsing.picture_decoding import photo_size

_FOLDERS: Final = (".", "images", "image", "photos", "input", "rgb", "Images", "JPEG", "DCIM")
_CAMERA_FILES: Final = (
    "transforms*.json",
    "cameras*.npz",
    "poses_bounds.npy",
    "*_par.txt",
    "sparse",
    "colmap",
    "cams",
    "blended_images",
)

_PROJECTS: Final = {
    ".psx": "Metashape's cameras as XML",
    ".psz": "Metashape's cameras as XML",
    ".rsproj": "RealityScan's registration as CSV or XMP",
    ".rcproj": "RealityCapture's registration as CSV or XMP",
    ".abc": "Meshroom's cameras.sfm",
    ".mg": "Meshroom's cameras.sfm",
}
"""Files of scanning programs that hold cameras but are not read, and what to export instead."""


@final
class PhotosReader(CaptureReader):
    """Reads the photographs of a folder, rotated by their EXIF orientation; an initializer estimates their cameras."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with two photographs and no camera file of another reader."""
        if not path.is_dir() or any(any(path.glob(pattern)) for pattern in _CAMERA_FILES):
            return False
        return len(_photos(path)) >= 2

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """All photographs, by name; a warning reports those of an unusual size."""
        if split != "train":
            raise CaptureError(
                f"{path} has no split {split!r}; read 'train', the only split of a folder of photographs"
            )
        photos = _photos(path)
        if len(photos) < 2:
            raise CaptureError(f"{path} has {len(photos)} photographs; add more, at least 2 and better 30")
        sizes = {photo: photo_size(photo, orient=True) for photo in photos}
        # portrait and landscape photographs of one camera count as one size
        (usual, _), *others = Counter(tuple(sorted(size)) for size in sizes.values()).most_common()
        if others:
            unusual = [p.name for p, size in sizes.items() if tuple(sorted(size)) != usual]
            warnings.warn(
                f"{len(unusual)} of {len(photos)} photographs are not {usual[1]}×{usual[0]} as the others are, "
                f"such as {unusual[0]}; they get separate intrinsics",
                stacklevel=2,
            )
        _warn_of_unread_cameras(path)
        names = unique_names(photos, path)
        masks = [find_mask(photo, path) for photo in photos]
        if all(masks) and (unmatched := found_masks(photos, path).of_none):
            warnings.warn(
                f"{len(unmatched)} masks belong to no photograph, such as {unmatched[0]}; name masks like their "
                "photographs",
                stacklevel=2,
            )
        views = tuple(
            View(name, None, PhotoFile(photo, mask, orient=True), path=photo, mask_path=mask)
            for photo, mask, name in zip(photos, masks, names, strict=True)
        )
        warn_of_mask_names(matches_of(views), path)
        return Capture(path=path, views=views, reader="photos")


def _warn_of_unread_cameras(path: Path) -> None:
    """Says once that a file which may hold the cameras is not read."""
    for file in sorted(path.iterdir()):
        suffix = file.suffix.lower()
        if suffix in _PROJECTS:
            reason = f"{file.name} is not read; export {_PROJECTS[suffix]} into this folder to use its cameras"
        elif suffix in (".xml", ".csv", ".out") and file.is_file() and file.stat().st_size == 0:
            reason = f"{file.name} is empty; export the cameras again if it should hold them"
        else:
            continue
        warnings.warn(f"{reason}, or they are estimated", stacklevel=3)
        return


def _photos(path: Path) -> list[Path]:
    """Photographs in the folder or its first usual subfolder; links that lead outside raise `CaptureError`."""
    for name in _FOLDERS:
        folder = path / name
        if not folder.is_dir():
            continue
        photos = sorted(p for p in folder.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES and p.is_file())
        if len(photos) >= 2:
            return [contained_path(path, p.relative_to(path).as_posix(), path) for p in photos]
    return []
