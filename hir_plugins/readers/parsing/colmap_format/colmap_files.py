"""The files of a COLMAP model, text and binary, parsed without COLMAP.

Why not by pycolmap: docs/adr/own_implementations.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.files.regular_files import refuse_special_file

from hir_core.capture import Array, OrientedPoints
from hir_core.capture.rotations import rotation_from_quaternion
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.capture_paths import MAX_TEXT_BYTES
from hir_plugins.readers.parsing.colmap_format.colmap_lenses import _MODELS, lens_camera
from hir_plugins.readers.parsing.lens_camera import LensCamera

_MAX_BINARY_BYTES = 8 << 30


@dataclass(frozen=True)
class ColmapImage:
    """A registered image."""

    name: str
    camera_id: int
    world_to_camera: Array


def read_cameras(folder: Path) -> dict[int, LensCamera]:
    """Cameras of cameras.bin or cameras.txt by identifier."""
    cameras: dict[int, LensCamera] = {}
    if (folder / "cameras.bin").is_file():
        stream = _Binary(folder / "cameras.bin")
        for _ in range(stream.count()):
            number, model, width, height = stream.take("<iiQQ")
            known = {identity: (name, size) for identity, name, size in _MODELS}
            if model not in known:
                raise CaptureError(f"{stream.path}: the camera model number {model} is unknown; export the model again")
            name, size = known[model]
            cameras[number] = lens_camera(name, stream.take(f"<{size}d"), width, height, str(stream.path))
    else:
        path = folder / "cameras.txt"
        for line in _lines(path):
            match line.split():
                case [number, name, width, height, *parameters]:
                    values = _numbers([width, height, *parameters], path, line)
                    cameras[_integer(number, path, line)] = lens_camera(
                        name, values[2:], int(values[0]), int(values[1]), str(path)
                    )
                case _:
                    raise CaptureError(f"{path}: the line {line[:80]!r} is not a camera; export the model again")
    if not cameras:
        raise CaptureError(f"{folder} has a COLMAP model without cameras; export the model again")
    return cameras


def read_images(folder: Path) -> list[ColmapImage]:
    """Registered images of images.bin or images.txt, by name."""
    images: list[ColmapImage] = []
    if (folder / "images.bin").is_file():
        stream = _Binary(folder / "images.bin")
        for _ in range(stream.count()):
            _, *pose, camera = stream.take("<I7dI")
            name = stream.text()
            (points,) = stream.take("<Q")
            stream.skip(24 * points)
            images.append(ColmapImage(name, camera, _pose(pose, str(stream.path))))
    else:
        path = folder / "images.txt"
        lines = _lines(path, keep_empty=True)
        for line in lines:
            if not line:
                continue
            fields = line.split(maxsplit=9)
            if len(fields) != 10:
                raise CaptureError(f"{path}: the line {line[:80]!r} is not an image; export the model again")
            pose = _numbers(fields[1:8], path, line)
            images.append(ColmapImage(fields[9].strip(), _integer(fields[8], path, line), _pose(pose, str(path))))
            next(lines, None)  # the image's observations, possibly an empty line
    if not images:
        raise CaptureError(f"{folder} has a COLMAP model without registered images; reconstruct it again")
    return sorted(images, key=lambda image: image.name)


def read_points(folder: Path) -> OrientedPoints | None:
    """Points and linear colours of points3D.bin or points3D.txt; None if there is no such file or it is empty."""
    rows: list[tuple[float, ...]] = []
    if (folder / "points3D.bin").is_file():
        stream = _Binary(folder / "points3D.bin")
        for _ in range(stream.count()):
            _, x, y, z, r, g, b, _, track = stream.take("<Q3d3BdQ")
            stream.skip(8 * track)
            rows.append((x, y, z, r, g, b))
    elif (folder / "points3D.txt").is_file():
        path = folder / "points3D.txt"
        for line in _lines(path):
            rows.append(tuple(_numbers(line.split(maxsplit=7)[1:7], path, line, count=6)))
    if not rows:
        return None
    table = np.array(rows, dtype=np.float64)
    table = table[np.isfinite(table).all(axis=1)]
    colors = srgb_to_linear(np.clip(table[:, 3:], 0, 255) / 255)
    return OrientedPoints(positions=table[:, :3], colors=colors) if len(table) else None


def _pose(values: list[float] | tuple[float, ...], owner: str) -> Array:
    """4×4 from a quaternion (w, x, y, z) and a translation."""
    numbers = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all() or not np.linalg.norm(numbers[:4]) > 1e-9:
        raise CaptureError(f"{owner}: the pose of an image is NaN, infinite or has no rotation; export the model again")
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(numbers[:4])
    pose[:3, 3] = numbers[4:]
    return pose


class _Binary:
    """A little-endian binary file with bounds checks."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if path.stat().st_size > _MAX_BINARY_BYTES:
                raise CaptureError(f"{path} is larger than {_MAX_BINARY_BYTES >> 30} GB; reduce the model")
            refuse_special_file(path)
            self._bytes = path.read_bytes()
        except OSError as error:
            raise CaptureError(f"{path} cannot be read ({error.strerror})") from None
        self._at = 0

    def count(self) -> int:
        """A number of records; each has at least one byte, so a number above the file's size is an error."""
        (number,) = self.take("<Q")
        if number > len(self._bytes):
            raise self._short()
        return int(number)

    def take(self, layout: str) -> tuple[Any, ...]:
        size = struct.calcsize(layout)
        if self._at + size > len(self._bytes):
            raise self._short()
        values = struct.unpack_from(layout, self._bytes, self._at)
        self._at += size
        return values

    def skip(self, size: int) -> None:
        if self._at + size > len(self._bytes):
            raise self._short()
        self._at += size

    def text(self) -> str:
        end = self._bytes.find(b"\0", self._at, self._at + 4096)
        if end < 0:
            raise self._short()
        value = self._bytes[self._at : end].decode("utf-8", "replace")
        self._at = end + 1
        return value

    def _short(self) -> CaptureError:
        return CaptureError(f"{self.path} ends in the middle of a record; export the model again")


def _lines(path: Path, keep_empty: bool = False) -> Iterator[str]:
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise CaptureError(f"{path} is larger than {MAX_TEXT_BYTES >> 20} MB; save the model as binary")
        refuse_special_file(path)
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CaptureError(f"{path} cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise CaptureError(f"{path} is not a text file; export the model again") from None
    for line in text.splitlines():
        if not line.startswith("#") and (keep_empty or line.strip()):
            yield line.strip()


def _numbers(fields: list[str], path: Path, line: str, count: int = 0) -> list[float]:
    try:
        values = [float(field) for field in fields]
    except ValueError:
        raise CaptureError(f"{path}: the line {line[:80]!r} contains a value that is not a number") from None
    if count and len(values) != count:
        raise CaptureError(f"{path}: the line {line[:80]!r} is too short; export the model again")
    if not all(math.isfinite(value) for value in values):
        raise CaptureError(f"{path}: the line {line[:80]!r} contains NaN or infinite numbers")
    return values


def _integer(field: str, path: Path, line: str) -> int:
    if not field.lstrip("-").isdecimal() or len(field) > 19:
        raise CaptureError(f"{path}: {field[:40]!r} in the line {line[:80]!r} is not a whole number")
    return int(field)
