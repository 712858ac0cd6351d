"""OpenMVG: `sfm_data.json` with views, intrinsics and extrinsics (OpenMVG documentation, "SfM data").

Pixel centres are at integers (its undistortion of images).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import Array
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import rigid_transform
from hir_plugins.readers.parsing.json_fields import number_field, read_json
from hir_plugins.readers.parsing.lens_camera import HALF_PIXEL, LensCamera
from hir_plugins.readers.parsing.posed_photos import PhotoFinder, PosedPhoto, PosedPhotosReader

_FILES: Final = ("sfm_data.json", "sfm_data_expanded.json")
_LENSES: Final = {"disto_k1": 1, "disto_k3": 3, "disto_t2": 5, "fisheye": 4}
"""Name of the list of coefficients for each lens model, and its length."""


@final
class OpenMvgReader(PosedPhotosReader[Path]):
    """Views whose pose and intrinsic are in the file."""

    name = "open_mvg"
    remedy = "no sfm_data.json; put that file of OpenMVG into this folder"

    def find(self, path: Path) -> Path | None:
        """sfm_data.json."""
        return next((path / name for name in _FILES if (path / name).is_file()), None)

    def cameras(self, source: Path, finder: PhotoFinder) -> list[PosedPhoto]:
        """Those that are registered."""
        del finder
        content = read_json(source)
        intrinsics, poses = _entries(content, "intrinsics", source), _entries(content, "extrinsics", source)
        cameras = []
        for view in _entries(content, "views", source).values():
            name = f"{view.get('local_path') or ''}/{view.get('filename') or ''}"
            owner = f"{source}, {view.get('filename')!r}"
            pose, intrinsic = poses.get(str(view.get("id_pose"))), intrinsics.get(str(view.get("id_intrinsic")))
            if pose is None or intrinsic is None:  # not reconstructed
                continue
            cameras.append(PosedPhoto(name, owner, _lens(intrinsic, owner), _pose(pose, owner)))
        return cameras


def _entries(content: Mapping[str, object], key: str, source: Path) -> dict[str, dict[str, object]]:
    """The values of a list of (key, value); cereal wraps polymorphic values into `ptr_wrapper.data`."""
    entries = content.get(key, [])
    found: dict[str, dict[str, object]] = {}
    for entry in entries if isinstance(entries, list) else [None]:
        value = entry.get("value") if isinstance(entry, dict) else None
        wrapper = value.get("ptr_wrapper") if isinstance(value, dict) else None
        data = wrapper.get("data") if isinstance(wrapper, dict) else value
        if not isinstance(entry, dict) or not isinstance(data, dict) or not isinstance(entry.get("key"), int):
            raise CaptureError(f"{source}: {key!r} is not a list of keys and values; export the file again")
        found[str(entry["key"])] = data
    return found


def _pose(entry: Mapping[str, object], owner: str) -> Array:
    try:
        rotation = np.array(entry.get("rotation"), dtype=np.float64).reshape(3, 3)
        center = np.array(entry.get("center"), dtype=np.float64).reshape(3)
    except (TypeError, ValueError, OverflowError):
        raise CaptureError(f"{owner}: its pose needs a 3×3 rotation and a centre; export the file again") from None
    return rigid_transform(np.concatenate([rotation, -(rotation @ center)[:, None]], axis=1), owner)


def _lens(table: Mapping[str, object], owner: str) -> LensCamera:
    pinhole = table.get("value0")  # cereal's name of a base class: versions differ in whether they nest it
    table = {**pinhole, **table} if isinstance(pinhole, dict) else table
    focal = number_field(table, "focal_length", owner)
    width, height = number_field(table, "width", owner), number_field(table, "height", owner)
    point = table.get("principal_point")
    if not focal or not width or not height or not isinstance(point, list) or len(point) != 2:
        raise CaptureError(f"{owner}: its intrinsic needs width, height, focal_length and principal_point")
    cx, cy = (number_field({"principal_point": value}, "principal_point", owner, 0.0) or 0.0 for value in point)
    cx, cy = cx + HALF_PIXEL, cy + HALF_PIXEL
    key = next((name for name in table if name.startswith("disto") or name == "fisheye"), None)
    if key is None:
        return LensCamera(focal, focal, cx, cy, width, height)
    values = table[key]
    if not isinstance(values, list) or len(values) != _LENSES.get(key):
        raise CaptureError(f"{owner}: the lens model {key!r} is not supported; undistort the photographs")
    numbers = [number_field({key: value}, key, owner, 0.0) or 0.0 for value in values]
    if key == "fisheye":
        return LensCamera(focal, focal, cx, cy, width, height, tuple(numbers), "fisheye")
    k1, k2, k3, t1, t2 = [*numbers, 0.0, 0.0, 0.0, 0.0][:5]
    return LensCamera(focal, focal, cx, cy, width, height, (k1, k2, t1, t2, k3))
