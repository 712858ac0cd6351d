"""RealityScan and RealityCapture: XMP sidecars beside the photographs, or the registration as CSV.

XMP: "RealityCapture XMP Camera Math" (Capturing Reality, knowledge base): x = R (X − position), lengths as shares of
the longer side of the image. CSV: "Internal/External camera parameters"; its angles as nerfstudio reads them. Lens:
RealityScan's own export for OpenCV writes `k1 k2 t2 t1 k3`, so t1 stands with r² + 2x²; its export templates write
px and py, which newer versions name `px_norm` and `py_norm`, as shares of the longer side.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Final, final
from xml.etree.ElementTree import Element

import numpy as np

from hir_core.capture import Array
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.capture_paths import PHOTO_SUFFIXES, contained_path
from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size
from hir_plugins.readers.parsing.lens_camera import LensCamera
from hir_plugins.readers.parsing.number_text import finite_number, finite_numbers
from hir_plugins.readers.parsing.posed_photos import PhotoFinder, PosedPhoto, PosedPhotosReader
from hir_plugins.readers.parsing.text_files import file_head, read_text
from hir_plugins.readers.parsing.xml_files import read_xml

_NAMESPACE: Final = "http://www.capturingreality.com/ns/xcr/1.1#"
_COLUMNS: Final = ("x", "y", "alt", "heading", "pitch", "roll", "f")
_RENAMED: Final = {"yaw": "heading", "f_35mm": "f", "px_norm": "px", "py_norm": "py"}
"""Columns of RealityScan 2, by their names in RealityCapture."""
FILM_WIDTH_MM = 36.0
"""Focal lengths are those of a 35 mm camera, whose longer side this is."""
LARGEST_SKEW = 1e-4
"""Skew up to this share of the image's longer side is neglected."""


@final
class RealityCaptureReader(PosedPhotosReader[list[Path]]):
    """XMP sidecars if there are any, because they hold exact rotations; otherwise the CSV."""

    name = "reality_capture"
    remedy = "no cameras of RealityScan; export XMP files beside the photographs, or the registration as CSV"

    def find(self, path: Path) -> list[Path] | None:
        """The sidecars, in the folder or one below, and the CSV."""
        table = _table(path)
        return [*_sidecars(path), *([] if table is None else [table])] or None

    def cameras(self, source: list[Path], finder: PhotoFinder) -> list[PosedPhoto]:
        """Those that are registered, in the order of their names."""
        sidecars = [file for file in source if file.suffix == ".xmp"]
        found = [camera for file in sidecars if (camera := _from_sidecar(finder.capture, file)) is not None]
        tables = [file for file in source if file.suffix == ".csv"]
        return found or [camera for file in tables for camera in _from_table(file, finder)]


def _sidecars(path: Path) -> Iterator[Path]:
    """XMP files of this program that belong to a photograph; other programs write XMP files too."""
    for folder in (path, *sorted(p for p in path.iterdir() if p.is_dir() and not p.name.startswith("."))):
        for file in sorted(folder.glob("*.xmp")):
            if _NAMESPACE.encode() in file_head(file) and _photo_of(file) is not None:
                yield file


def _photo_of(sidecar: Path) -> Path | None:
    names = (sidecar.with_suffix(suffix) for suffix in PHOTO_SUFFIXES)
    return next((p for name in names for p in (name, name.with_suffix(name.suffix.upper())) if p.is_file()), None)


def _from_sidecar(path: Path, file: Path) -> PosedPhoto | None:
    photo = _photo_of(file)
    description = next((e for e in read_xml(file).iter() if _field(e, "FocalLength35mm") is not None), None)
    if photo is None or description is None or _field(description, "Rotation") is None:
        return None  # not registered
    owner = str(file)
    rotation = np.reshape(_numbers(description, "Rotation", 9, owner), (3, 3))
    position = np.array(_numbers(description, "Position", 3, owner))
    pose = rigid_transform(np.concatenate([rotation, -(rotation @ position)[:, None]], axis=1), owner)
    (skew,), (aspect,) = (_numbers(description, n, 1, owner, d) for n, d in (("Skew", "0"), ("AspectRatio", "1")))
    if abs(skew) > LARGEST_SKEW:
        raise CaptureError(f"{owner}: the skew {skew:g} is not supported; align the photographs with square pixels")
    (focal,) = _numbers(description, "FocalLength35mm", 1, owner)
    (u,), (v,) = (_numbers(description, name, 1, owner, "0") for name in ("PrincipalPointU", "PrincipalPointV"))
    model = _field(description, "DistortionModel") or "perspective"
    lens = _numbers(description, "DistortionCoeficients", 6, owner, "0 0 0 0 0 0")  # their spelling
    if any(lens) and not model.startswith("brown"):
        raise CaptureError(f"{owner}: the lens model {model!r} is not supported; align with the model Brown3")
    name = photo.relative_to(path).as_posix()
    photo = contained_path(path, name, file)
    return PosedPhoto(name, owner, _lens(photo, focal / FILM_WIDTH_MM, aspect, u, v, lens, owner), pose, photo=photo)


def _table(path: Path) -> Path | None:
    """The CSV whose header names the columns; a line `#cameras N` may stand before it."""
    for file in sorted(path.glob("*.csv"))[:20]:
        if any(line.startswith(b"#name,") for line in file_head(file).splitlines()[:2]):
            return file
    return None


def _from_table(source: Path, finder: PhotoFinder) -> list[PosedPhoto]:
    lines = read_text(source).splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("#name,"))
    header = [_RENAMED.get(name.strip(), name.strip()) for name in lines[start][1:].split(",")]
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise CaptureError(
            f"{source} has no column {missing[0]!r}; export the registration as Internal/External camera parameters"
        )
    cameras = []
    for row in _rows(lines[start + 1 :], source):
        owner = f"{source}, {row[0]!r}"
        value = {key: finite_number(text, owner) for key, text in zip(header[1:], row[1:], strict=False)}
        if any(name not in value for name in _COLUMNS):
            raise CaptureError(f"{owner}: the line has {len(row)} of {len(header)} columns; export it again")
        pose = np.eye(4)
        pose[:3, :3] = _rotation(value["heading"], value["pitch"], value["roll"])
        pose[:3, 3] = [value["x"], value["y"], value["alt"]]
        lens = [value.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "t1", "t2")]
        u, v = (value.get(name, 0.0) for name in ("px", "py"))
        camera = _lens(finder.find(row[0], owner), value["f"] / FILM_WIDTH_MM, 1.0, u, v, lens, owner)
        world_to_camera = OPENCV_FROM_OPENGL @ rigid_inverse(rigid_transform(pose, owner))
        cameras.append(PosedPhoto(row[0], owner, camera, world_to_camera))
    return cameras


def _rows(lines: list[str], source: Path) -> list[list[str]]:
    """The fields of each line that has any."""
    try:
        return list(csv.reader(line for line in lines if line.strip()))
    except csv.Error as error:
        raise CaptureError(f"{source} is not a CSV file ({error}); export the registration again") from None


def _rotation(heading: float, pitch: float, roll: float) -> Array:
    """Camera (axes as OpenGL's) to world (+Z up), from degrees: heading about −z, pitch about x, roll about y."""
    (cz, cx, cy), (sz, sx, sy) = (of(np.radians([-heading, pitch, roll])) for of in (np.cos, np.sin))
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return np.asarray(about_z @ about_x @ about_y)


def _lens(
    photo: Path, focal: float, aspect: float, u: float, v: float, coefficients: list[float], owner: str
) -> LensCamera:
    """From lengths that are shares of the longer side, and k1 k2 k3 k4 t1 t2."""
    k1, k2, k3, k4, t1, t2 = coefficients
    if k4:
        raise CaptureError(f"{owner}: the lens uses k4, which is not supported; align with the model Brown3")
    width, height = photo_size(photo)
    side = max(width, height)
    center = (width / 2 + u * side, height / 2 + v * side)
    return LensCamera(focal * side, focal * aspect * side, *center, width, height, (k1, k2, t2, t1, k3))


def _field(element: Element, name: str) -> str | None:
    """A property of the XMP, which is an attribute or an element of its own."""
    value = element.get(f"{{{_NAMESPACE}}}{name}")
    return element.findtext(f"{{{_NAMESPACE}}}{name}") if value is None else value


def _numbers(element: Element, name: str, count: int, owner: str, default: str | None = None) -> list[float]:
    return finite_numbers(_field(element, name) or default, count, f"{owner}, {name}")
