"""Meshroom (AliceVision): a `.sfm` file in JSON, such as `cameras.sfm`, or a `.json` of its ConvertSfMFormat.

Sources: the change log of AliceVision's sfmDataIO (principal points are offsets from the middle since version 1.2.1,
focal lengths in millimetres since 1.2.2), its camera models, and its undistortion of images (pixel centres are at
integers).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import Array
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import rigid_transform
from hir_plugins.readers.parsing.json_fields import read_json
from hir_plugins.readers.parsing.lens_camera import HALF_PIXEL, LensCamera
from hir_plugins.readers.parsing.posed_photos import PhotoFinder, PosedPhoto, PosedPhotosReader
from hir_plugins.readers.parsing.text_files import file_head

_CENTERED_SINCE: Final = (1, 2, 1)
_NO_RIG: Final = ("", "-1", "4294967295")
_RADIAL: Final = {"pinhole": 0, "none": 0, "radial1": 1, "radialk1": 1, "radial3": 3, "radialk3": 3, "brown": 5}
_FISHEYE: Final = ("fisheye", "fisheye4")


@final
class MeshroomReader(PosedPhotosReader[Path]):
    """Views with a pose; numbers of the file may be text."""

    name = "meshroom"
    remedy = "no .sfm file; put cameras.sfm of Meshroom into this folder"

    def find(self, path: Path) -> Path | None:
        """cameras.sfm, or the first .sfm file, or the first .json file that holds the same."""
        files = sorted(p for p in path.glob("*.sfm") if p.is_file())
        cameras = next((f for f in files if f.name == "cameras.sfm"), files[0] if files else None)
        return cameras or next((f for f in sorted(path.glob("*.json"))[:20] if _is_sfm(file_head(f))), None)

    def cameras(self, source: Path, finder: PhotoFinder) -> list[PosedPhoto]:
        """Those that are registered."""
        del finder
        content = read_json(source)
        version = _version(content.get("version"))
        intrinsics = {str(i.get("intrinsicId")): i for i in _tables(content, "intrinsics", source)}
        poses = {str(p.get("poseId")): p for p in _tables(content, "poses", source)}
        cameras = []
        for view in _tables(content, "views", source):
            name = str(view.get("path", ""))
            owner = f"{source}, {name!r}"
            pose, intrinsic = poses.get(str(view.get("poseId"))), intrinsics.get(str(view.get("intrinsicId")))
            if pose is None or intrinsic is None:  # not reconstructed
                continue
            if str(view.get("rigId", "")) not in _NO_RIG:
                raise CaptureError(f"{owner}: rigs are not supported; reconstruct the photographs without a rig")
            cameras.append(PosedPhoto(name, owner, _lens(intrinsic, version, owner), _pose(pose, owner)))
        return cameras


def _is_sfm(head: bytes) -> bool:
    """Whether the first bytes of a JSON file are AliceVision's: a version, then views with their numbers."""
    return b'"version"' in head and b'"views"' in head and b'"viewId"' in head


def _version(value: object) -> tuple[int, ...]:
    parts = value if isinstance(value, list) else []
    return tuple(int(part) if str(part).isdecimal() and len(str(part)) < 6 else 0 for part in parts)


def _tables(content: Mapping[str, object], key: str, source: Path) -> list[dict[str, object]]:
    entries = content.get(key, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise CaptureError(f"{source}: {key!r} is not a list of objects; export the file again")
    return entries


def _pose(entry: Mapping[str, object], owner: str) -> Array:
    pose = entry.get("pose")
    transform = pose.get("transform") if isinstance(pose, dict) else None
    if not isinstance(transform, dict):
        raise CaptureError(f"{owner}: its pose has no transform; export the file again")
    # the list is the matrix of the world in the camera, by columns
    rotation = _numbers(transform.get("rotation"), 9, owner, "rotation").reshape(3, 3).T
    center = _numbers(transform.get("center"), 3, owner, "center")
    return rigid_transform(np.concatenate([rotation, -(rotation @ center)[:, None]], axis=1), owner)


def _lens(table: Mapping[str, object], version: tuple[int, ...], owner: str) -> LensCamera:
    width, height = (_number(table.get(key), owner, key) for key in ("width", "height"))
    if "pxFocalLength" in table:
        value = table["pxFocalLength"]
        fx, fy = _numbers(value if isinstance(value, list) else [value, value], 2, owner, "pxFocalLength")
    else:
        if _number(table.get("pixelRatio", 1), owner, "pixelRatio") != 1:
            raise CaptureError(f"{owner}: pixels that are not square are not supported; undistort the photographs")
        sensor = _number(table.get("sensorWidth"), owner, "sensorWidth")
        if sensor <= 0:
            raise CaptureError(f"{owner}: the sensor is {sensor:g} mm wide; export the file again")
        fx = fy = _number(table.get("focalLength"), owner, "focalLength") * width / sensor
    cx, cy = _numbers(table.get("principalPoint"), 2, owner, "principalPoint")
    if version >= _CENTERED_SINCE:
        cx, cy = cx + width / 2, cy + height / 2
    cx, cy = cx + HALF_PIXEL, cy + HALF_PIXEL
    projection = str(table.get("type") or "pinhole").lower()
    if projection not in (*_RADIAL, *_FISHEYE):  # such as equidistant, whose distortion has the names of a pinhole's
        raise CaptureError(f"{owner}: the projection {projection!r} is not supported; undistort the photographs")
    kind = "fisheye4" if projection in _FISHEYE else str(table.get("distortionType") or projection).lower()
    parameters = table.get("distortionParams") or []
    count = len(parameters) if isinstance(parameters, list) else 0
    values = _numbers(parameters, count, owner, "distortionParams").tolist()
    expected = 4 if kind in _FISHEYE else _RADIAL.get(kind)
    if expected is None or (count and count != expected):
        raise CaptureError(f"{owner}: the lens model {kind!r} is not supported; undistort the photographs")
    if kind in _FISHEYE:
        return LensCamera(fx, fy, cx, cy, width, height, tuple(values), "fisheye")
    k1, k2, k3, t1, t2 = [*values, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return LensCamera(fx, fy, cx, cy, width, height, (k1, k2, t1, t2, k3))


def _number(value: object, owner: str, key: str) -> float:
    return float(_numbers([value], 1, owner, key)[0])


def _numbers(value: object, count: int, owner: str, key: str) -> Array:
    try:
        numbers = np.array([float(str(part)) for part in value], np.float64) if isinstance(value, list) else np.zeros(0)
    except (ValueError, OverflowError):
        numbers = np.full(count, np.nan)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise CaptureError(f"{owner}: {key!r} needs {count} finite numbers; export the file again")
    return numbers
