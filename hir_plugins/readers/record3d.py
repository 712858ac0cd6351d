"""Record3D: recordings of the app as .r3d, with ARKit's cameras and the depth of LiDAR or of the front camera.

A .r3d is a zip archive of `metadata` (JSON) and, for each frame, `rgbd/N.jpg`, `rgbd/N.depth` (metres, float32,
compressed with LZFSE) and `rgbd/N.conf` (ARKit's levels 0 to 2, a byte each, compressed likewise). An unpacked archive
is read as well.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final, final

import numpy as np
from hir_exporters.files.untrusted_json import parse_json
from hir_exporters.textures.pillow_images import open_image

from hir_core.capture import Capture, MeasuredDepth, View
from hir_core.errors import CaptureError, InputError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.capture_paths import contained_path
from hir_plugins.readers.parsing.lens_camera import pinhole_camera
from hir_plugins.readers.parsing.mask_files import find_mask, warn_of_mask_names
from hir_plugins.readers.parsing.record3d_format.metadata import RecordingMetadata, parse_metadata
from hir_plugins.readers.parsing.record3d_format.recorded_frames import RecordedPhoto, recorded_depth
from hir_plugins.readers.parsing.record3d_format.recording_files import RecordingFile, files_of_archive
from hir_plugins.readers.video import FRAMES, laplacian_variance, sharpest_in_intervals

SUFFIX: Final = ".r3d"
FRAMES_COMPARED: Final = 8
"""A recording has up to 60 frames a second: so many of each part, evenly spaced, are compared for their sharpness."""

_COMPARISON_SIDE_PIXELS: Final = 240
"""Shorter side down to which the decoder may reduce a photograph before its sharpness is measured."""


@dataclass(frozen=True)
class _Recording:
    folder: Path | None
    """Where masks are looked for; None for a file alone, beside which the masks of others may lie."""
    files: Mapping[str, RecordingFile]


@final
class Record3DReader(CaptureReader):
    """Takes the sharpest frame of each of 80 equal parts of a recording, with its camera and depth."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A .r3d, a folder with one, or a folder with the files of one."""
        return _archive(path) is not None or _is_unpacked(path)

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Views in ARKit's world: +Y up, in metres. A damaged recording raises `CaptureError`."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of a recording")
        recording = _open(path)
        if "metadata" not in recording.files:
            raise CaptureError(f"{path} holds no 'metadata'; export the recording again as .r3d")
        metadata = _metadata(recording.files["metadata"])
        frames = [n for n in range(len(metadata.poses)) if f"rgbd/{n}.jpg" in recording.files]
        if not frames:
            raise CaptureError(f"{path} has no photograph with a camera; export the recording again as .r3d")
        if len(frames) < len(metadata.poses):
            warnings.warn(f"{len(metadata.poses) - len(frames)} frames of {path.name} have no photograph", stacklevel=2)
        views = _views(recording, metadata, _sharpest(recording, frames))
        if recording.folder is not None:
            photos = [recording.folder / "rgbd" / f"{n}.jpg" for n in frames]
            masks = {int(view.name): view.mask_path for view in views}
            pairs = [(p, masks[n]) for n, p in zip(frames, photos, strict=True) if n in masks]
            warn_of_mask_names(pairs, recording.folder, photos)
        return Capture(path, views, reader="record3d", metres_from="ARKit")


def _views(recording: _Recording, metadata: RecordingMetadata, frames: list[int]) -> tuple[View, ...]:
    files = recording.files
    width, height = _photo_size(files[f"rgbd/{frames[0]}.jpg"])
    with_depth = _can_decompress(files, frames)
    views = []
    for n in frames:
        photo, owner = files[f"rgbd/{n}.jpg"], f"{metadata.owner}, frame {n}"
        camera = pinhole_camera(metadata.lens(n), metadata.world_to_camera(n), width, height, owner)
        folder = recording.folder
        mask = None if folder is None else find_mask(folder / "rgbd" / f"{n}.jpg", folder)
        depth: MeasuredDepth | None = None
        if with_depth and f"rgbd/{n}.depth" in files:
            depth = recorded_depth(files[f"rgbd/{n}.depth"], files.get(f"rgbd/{n}.conf"), metadata)
        read = RecordedPhoto(photo, width, height, mask)
        views.append(View(f"{n:05d}", camera, read, path=photo.path, mask_path=mask, depth=depth))
    return tuple(views)


def _can_decompress(files: Mapping[str, RecordingFile], frames: list[int]) -> bool:
    """Whether depth maps can be read; a warning says what to install where they cannot."""
    if not any(f"rgbd/{n}.depth" in files for n in frames):
        return False
    if find_spec("lzfse") is None:
        warnings.warn("the depth maps are not used; install their decompression with: pip install lzfse", stacklevel=2)
        return False
    return True


def _sharpest(recording: _Recording, frames: list[int]) -> list[int]:
    """At most `FRAMES` of the frames."""
    if len(frames) <= FRAMES:
        return frames
    compared = frames[:: max(1, len(frames) // (FRAMES * FRAMES_COMPARED))]
    sharp = np.array([_sharpness(recording.files[f"rgbd/{n}.jpg"]) for n in compared])
    return [compared[i] for i in sharpest_in_intervals(sharp, FRAMES)]


def _sharpness(file: RecordingFile) -> float:
    try:
        with open_image(file.read(), name=file.name) as image:
            factor = max(1, min(image.size) // _COMPARISON_SIDE_PIXELS)
            image.draft("L", (image.width // factor, image.height // factor))
            return laplacian_variance(np.asarray(image.convert("L"), dtype=np.float32))
    except (InputError, OSError, ValueError, SyntaxError) as error:
        raise CaptureError(f"{file.name} is damaged ({error}); export the recording again") from None


def _photo_size(file: RecordingFile) -> tuple[int, int]:
    try:
        with open_image(file.read(), name=file.name) as image:
            return image.size
    except InputError as error:
        raise CaptureError(str(error)) from None


def _metadata(file: RecordingFile) -> RecordingMetadata:
    try:
        document = parse_json(file.read())
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{file.name} is not valid JSON ({error}); export the recording again") from None
    if not isinstance(document, dict):
        raise CaptureError(f"{file.name} is not a JSON object; export the recording again")
    return parse_metadata(document, file.name)


def _open(path: Path) -> _Recording:
    archive = _archive(path)
    if archive is not None:
        return _Recording(path if path.is_dir() else None, files_of_archive(archive))
    if not _is_unpacked(path):
        raise CaptureError(f"{path} is no recording of Record3D; give a .r3d, or a folder with 'metadata' and 'rgbd'")
    files = [file for file in (path / "rgbd").iterdir() if file.resolve().is_relative_to(path.resolve())]
    found = {f"rgbd/{file.name}": RecordingFile(file, str(file)) for file in files}
    metadata = contained_path(path, "metadata", path)
    return _Recording(path, {"metadata": RecordingFile(metadata, str(metadata))} | found)


def _is_unpacked(path: Path) -> bool:
    return (path / "metadata").is_file() and (path / "rgbd").is_dir()


def _archive(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() == SUFFIX else None
    if not path.is_dir() or _is_unpacked(path):
        return None
    found = [file for file in sorted(path.iterdir()) if file.suffix.lower() == SUFFIX and file.is_file()]
    return found[0] if len(found) == 1 and found[0].resolve().is_relative_to(path.resolve()) else None
