"""Paths in a capture's files, which must stay inside the capture's folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path, PureWindowsPath

from hir_core.errors import CaptureError
from hir_core.files.file_names import check_text_path

PHOTO_SUFFIXES = (
    ".png",
    ".jpg",
    ".jpeg",
    ".tif",
    ".tiff",
    ".webp",
    ".bmp",
    ".exr",
    ".hdr",
    ".heic",
    ".heif",
    ".avif",
    ".dng",
    ".cr2",
    ".cr3",
    ".nef",
    ".arw",
    ".raf",
    ".rw2",
    ".orf",
)
"""Suffixes of photographs, in the order in which they are tried for a name without a suffix."""

MAX_TEXT_BYTES = 256 << 20
"""Largest accepted size of a capture's text files; a thousand cameras need one megabyte."""


def contained_path(folder: Path, name: str, owner: Path) -> Path:
    """The path of `name`, which the file `owner` names, in `folder`; paths outside it raise `CaptureError`."""
    if not name or "\0" in name:
        raise CaptureError(f"{owner}: {name!r} is not a file name; name a file of the capture")
    # drive letters and leading backslashes are refused on all systems, so that captures are portable
    if Path(name).is_absolute() or PureWindowsPath(name).drive or PureWindowsPath(name).root:
        raise CaptureError(f"{owner}: {name!r} is an absolute path; name files relative to the capture's folder")
    path = folder / name.replace("\\", "/")
    try:
        contained = path.resolve().is_relative_to(folder.resolve())
        special = path.exists() and not path.is_file() and not path.is_dir()
    except (OSError, RuntimeError, ValueError) as error:  # also half a character, which no file name holds
        raise CaptureError(f"{owner}: {name!r} cannot be resolved ({error}); rename the file") from None
    if special:
        raise CaptureError(f"{owner}: {name!r} is not a regular file; remove it")
    if not contained:
        raise CaptureError(f"{owner}: {name!r} leads out of {folder}; move the file into the capture's folder")
    return path


def find_photo(folder: Path, name: str, owner: Path) -> Path:
    """As `contained_path`, for an existing photograph; a missing suffix (NeRF-synthetic) is completed."""
    path = contained_path(folder, name, owner)
    if path.is_file():
        return path
    if path == folder or not path.name:
        raise CaptureError(f"{owner}: {name!r} names a folder, not an image; name a file of the capture")
    for suffix in PHOTO_SUFFIXES:
        for ending in (suffix, suffix.upper()):
            candidate = path.with_name(path.name + ending)
            if candidate.is_file():
                return contained_path(folder, name + ending, owner)
    raise CaptureError(f"{owner} names the image {name!r}, which is not in {folder}; add the file or remove its entry")


def is_photo_name(name: str) -> bool:
    """Whether a file is a photograph, by its name; hidden files are not, such as `._a.jpg`, which macOS writes."""
    return Path(name).suffix.lower() in PHOTO_SUFFIXES and not name.startswith(".")


def photos_of(folder: Path) -> list[Path]:
    """The photographs directly in a folder, by name; whether links lead out of the capture is not checked."""
    return sorted(p for p in folder.iterdir() if is_photo_name(p.name) and p.is_file())


def photos_in_first_folder(capture: Path, folders: Sequence[str]) -> list[Path]:
    """The photographs, by name, of the first of `folders` that exists; if none exists, `CaptureError` is raised."""
    for name in folders:
        if (capture / name).is_dir():
            photos = sorted(p for p in (capture / name).iterdir() if is_photo_name(p.name))
            return [contained_path(capture, p.relative_to(capture).as_posix(), capture) for p in photos]
    raise CaptureError(f"{capture} has none of the folders {', '.join(folders)}; put the images into one of them")


def unique_names(paths: Iterable[Path], folder: Path) -> list[str]:
    """One name for each file: its stem, or its relative path with `_` for `/` if stems repeat, with the suffix if that
    repeats, too.

    A file name that is not text (on Linux any bytes may be one) raises `CaptureError`, and so do two files that get one
    name.
    """
    listed = list(paths)
    for path in listed:
        check_text_path(path)
    stems = [path.stem for path in listed]
    if len(set(stems)) == len(stems):
        return stems
    relative = [path.relative_to(folder) for path in listed]
    files = [path.as_posix().replace("/", "_") for path in relative]
    for names in ([path.with_suffix("").as_posix().replace("/", "_") for path in relative], files):
        if len(set(names)) == len(set(listed)):  # a file may be listed twice
            return names
    raise CaptureError(f"{folder}: two photographs would have one name; rename their files or folders")
