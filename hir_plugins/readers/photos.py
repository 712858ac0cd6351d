"""A folder of photographs without cameras, or one folder for each take, with or without masks."""

from __future__ import annotations

import contextlib
import warnings
from collections import Counter
from pathlib import Path
from typing import Final, final

from hir_exporters.reading.base_color_texture import named_files

from hir_core.capture import Capture, View
from hir_core.errors import CaptureError, HirError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.capture_paths import contained_path, photos_of, unique_names
from hir_plugins.readers.parsing.decoding.photo_file import PhotoFile
from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size
from hir_plugins.readers.parsing.mask_files import find_mask, found_masks, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.takes_file import (
    TAKES_FILE,
    has_takes_file,
    read_takes,
    refuse_shared_masks,
    take_folders,
    unlisted_photographs,
)

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

MESH_SUFFIXES: Final = (".obj", ".ply", ".gltf", ".glb")
MAX_MESHES: Final = 20
"""Meshes beside the photographs whose textures are looked for."""

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
    """Reads the photographs of a folder, rotated by their EXIF orientation; an initializer estimates their cameras.

    takes.toml lists the folders of several takes.
    """

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with two photographs, or with takes.toml, and no camera file of another reader."""
        if not path.is_dir() or any(any(path.glob(pattern)) for pattern in _CAMERA_FILES):
            return False
        return has_takes_file(path) or len(_photos(path)) >= 2

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """All photographs, by take and name; a warning reports those of an unusual size."""
        if split != "train":
            raise CaptureError(
                f"{path} has no split {split!r}; read 'train', the only split of a folder of photographs"
            )
        takes = _takes(path)
        photos = [photo for _, photo in takes] if takes else _without_textures(_photos(path), path)
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
        labels = [take for take, _ in takes] or [""] * len(photos)
        if all(masks) and (unmatched := found_masks(photos, path).of_none):
            warnings.warn(
                f"{len(unmatched)} masks belong to no photograph, such as {unmatched[0]}; name masks like their "
                "photographs",
                stacklevel=2,
            )
        views = tuple(
            View(name, None, PhotoFile(photo, mask, orient=True), path=photo, mask_path=mask, take=take)
            for photo, mask, name, take in zip(photos, masks, names, labels, strict=True)
        )
        refuse_shared_masks(views)
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


def _takes(path: Path) -> list[tuple[str, Path]]:
    """The photographs in the folders that takes.toml lists, each with its take; empty without that file."""
    names = read_takes(path)
    if not names:
        return []
    folders = take_folders(path, names, _FOLDERS)
    listed = [(name, photo) for name, folder in zip(names, folders, strict=True) for photo in photos_of(folder)]
    found = [(name, contained_path(path, p.relative_to(path).as_posix(), path)) for name, p in listed]
    without = [name for name in names if all(take != name for take, _ in found)]
    if without:
        raise CaptureError(
            f"{path / TAKES_FILE} lists the take {without[0]!r}, whose folder holds no photograph; add its photographs"
        )
    unlisted = unlisted_photographs(path, folders)
    if len(unlisted) >= 2:
        warnings.warn(
            f"{len(unlisted)} photographs lie in no folder that {path / TAKES_FILE} lists and are left out, such as "
            f"{unlisted[0]}; list their folder, or move them away",
            stacklevel=3,
        )
    return found


def _without_textures(photos: list[Path], path: Path) -> list[Path]:
    """The photographs without pictures that a mesh beside them names: a scan's texture is none. A warning names one."""
    folders = dict.fromkeys([path, *(photo.parent for photo in photos)])
    meshes = [f for folder in folders for f in sorted(folder.iterdir()) if f.suffix.lower() in MESH_SUFFIXES]
    textures: set[Path] = set()
    for mesh in meshes[:MAX_MESHES]:
        with contextlib.suppress(HirError):  # whoever reads the mesh says what is wrong with it
            textures |= {file.resolve() for file in named_files(mesh)}
    found = [photo for photo in photos if photo.resolve() in textures]
    if found:
        warnings.warn(
            f"{len(found)} pictures are textures of a mesh in the same folder and no photographs, such as "
            f"{found[0].name}; they are left out",
            stacklevel=3,
        )
    return [photo for photo in photos if photo not in found]


def _photos(path: Path) -> list[Path]:
    """Photographs in the folder or its first usual subfolder; links that lead outside raise `CaptureError`."""
    for name in _FOLDERS:
        folder = path / name
        if not folder.is_dir():
            continue
        photos = photos_of(folder)
        if len(photos) >= 2:
            return [contained_path(path, p.relative_to(path).as_posix(), path) for p in photos]
    return []
