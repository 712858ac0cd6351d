"""Captures described by transforms.json: NeRF-synthetic, nerfstudio, instant-ngp (docs/captures.md)."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final, final

from hir_core.capture import Capture, EnvironmentSource, MeasuredDepth, View
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import (
    BLENDER_FROM_LATLONG,
    OPENCV_FROM_OPENGL,
    WORLD_FROM_Z_UP,
    rigid_inverse,
    rigid_transform,
)
from hir_plugins.readers.parsing.capture_paths import contained_path, find_photo, unique_names
from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size
from hir_plugins.readers.parsing.depth_file import MILLIMETRE, depth_map
from hir_plugins.readers.parsing.json_fields import number_field, read_json
from hir_plugins.readers.parsing.lens_camera import LensCamera, make_view
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.takes_file import refuse_shared_masks, take_name, with_takes

MIN_DEPTH_UNIT: Final = 1e-9
"""Smallest length of one unit of a depth map; the largest is its inverse."""
MIN_ANGLE: Final = 1e-6
"""Smallest angle of view, in radians."""
_RADIAL: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE: Final = ("k1", "k2", "k3", "k4")
_MODELS: Final = (
    "OPENCV",
    "OPENCV_FISHEYE",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "PERSPECTIVE",
    "RADIAL",
    "SIMPLE_RADIAL",
    "FULL_OPENCV",
)
_SPLIT_LISTS: Final = {"train": "train_filenames", "val": "val_filenames", "test": "test_filenames"}


@final
class TransformsJsonReader(CaptureReader):
    """Reads `transforms_<split>.json`, or `transforms.json` as the training split; world +Z up, cameras as OpenGL's.

    Of a capture of takes, each frame names its `take`.
    """

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with such a file, or the file itself; no file is opened."""
        return bool(_files(path))

    def splits(self, path: Path) -> list[str]:
        """Names of the splits, train and test first; only a single transforms.json is opened, for its file lists."""
        files = _files(path)
        splits = set(files)
        if list(files) == ["train"]:
            content = read_json(files["train"])
            splits |= {split for split, key in _SPLIT_LISTS.items() if content.get(key)}
        order = {"train": 0, "test": 1, "val": 2}
        return sorted(splits, key=lambda split: (order.get(split, 3), split))

    def read(self, path: Path, split: str = "train") -> Capture:
        """Cameras, names and image sizes (from the headers) of one split; no other split's file is opened."""
        files = _files(path)
        source = files.get(split) or (files["train"] if list(files) == ["train"] else None)
        if source is None:
            known = ", ".join(sorted(files)) or "none"
            raise CaptureError(f"{path} has no split {split!r} (transforms_{split}.json); installed: {known}")
        content = read_json(source)
        frames = _frames_of_split(content, split, source, own_file=split in files)
        takes = _takes(content, source)
        folder = source.parent
        photos = [find_photo(folder, _text(f, "file_path", source, i), source) for i, f in frames]
        views = tuple(
            _view(content, frame, source, index, photo, name)
            for (index, frame), photo, name in zip(frames, photos, unique_names(photos, folder), strict=True)
        )
        if takes:
            views = tuple(replace(view, take=takes[index]) for (index, _), view in zip(frames, views, strict=True))
            # a mask that a frame names may serve photographs of one camera under two lights
            refuse_shared_masks(v for (_, frame), v in zip(frames, views, strict=True) if "mask_path" not in frame)
        else:
            views = with_takes(views, folder, whole=split == "train")
        # by their names alone: photographs of another split have masks, too
        others = (photo for each in files if each != split for photo in folder.glob(f"{each}/*"))
        warn_of_mask_names(matches_of(views), folder, others)
        return Capture(
            path=path,
            views=views,
            split=split,
            world_from_source=WORLD_FROM_Z_UP.copy(),
            environment=_environment(content, source),
            reader="transforms_json",
        )


def _files(path: Path) -> dict[str, Path]:
    """The file of each split."""
    if path.is_file():
        named = path.name.startswith("transforms") and path.suffix == ".json"
        return {path.stem.partition("transforms_")[2] or "train": path} if named else {}
    split_files = {f.stem.partition("transforms_")[2]: f for f in sorted(path.glob("transforms_*.json")) if f.is_file()}
    whole = path / "transforms.json"
    if "train" not in split_files and whole.is_file():
        split_files["train"] = whole
    return split_files


def _frames_of_split(
    content: dict[str, object], split: str, source: Path, own_file: bool
) -> list[tuple[int, dict[str, object]]]:
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise CaptureError(
            f"{source} has no frames; write a list 'frames' of objects with 'file_path' and 'transform_matrix'"
        )
    numbered = list(enumerate(frames))
    listed = _listed_names(content, _SPLIT_LISTS.get(split, ""))
    if listed:
        chosen = [(i, f) for i, f in numbered if str(f.get("file_path")) in listed]
    else:  # a fit must not see what the file keeps for tests
        others = set().union(*(_listed_names(content, key) for key in _SPLIT_LISTS.values()))
        chosen = [(i, f) for i, f in numbered if str(f.get("file_path")) not in others] if own_file else []
    if not chosen:
        place = f"the list {_SPLIT_LISTS[split]!r}" if split in _SPLIT_LISTS else f"transforms_{split}.json"
        raise CaptureError(f"{source} lists no frame of the split {split!r}; name its photographs in {place}")
    return chosen


def _listed_names(content: dict[str, object], key: str) -> set[str]:
    """The photographs that the file lists for a split; empty without a list."""
    names = content.get(key)
    return {name for name in names if isinstance(name, str)} if isinstance(names, list) else set()


def _takes(content: dict[str, object], source: Path) -> list[str]:
    """The take of each frame of the file, of all splits; empty where no frame has one."""
    frames = content["frames"]
    assert isinstance(frames, list)  # `_frames_of_split` comes first
    values = [frame.get("take") for frame in frames]
    if all(value is None for value in values):
        return []
    if None in values:
        raise CaptureError(
            f"{source}, frame {values.index(None)} has no 'take', and other frames have one; name the take of each "
            "frame, or of none"
        )
    return [take_name(value, f"{source}, frame {index}") for index, value in enumerate(values)]


def _view(
    content: dict[str, object], frame: dict[str, object], source: Path, index: int, photo: Path, name: str
) -> View:
    owner = f"{source}, frame {index}"
    merged = {**content, **frame}
    camera_to_source = rigid_transform(frame.get("transform_matrix"), owner)
    world_from_camera = WORLD_FROM_Z_UP @ camera_to_source @ OPENCV_FROM_OPENGL
    mask_name = frame.get("mask_path")
    mask = find_photo(source.parent, str(mask_name), source) if mask_name else find_mask(photo, source.parent)
    depth = _depth(merged, source, owner)
    return make_view(name, photo, _lens(merged, owner, photo), rigid_inverse(world_from_camera), owner, mask, depth)


def _depth(frame: dict[str, object], source: Path, owner: str) -> MeasuredDepth | None:
    """nerfstudio's `depth_file_path`, in millimetres unless `depth_unit_scale_factor` says otherwise."""
    name, confidence = frame.get("depth_file_path"), frame.get("confidence_file_path")
    if not name:
        return None
    unit = number_field(frame, "depth_unit_scale_factor", owner, MILLIMETRE)
    if unit is None or not MIN_DEPTH_UNIT <= unit <= 1 / MIN_DEPTH_UNIT:
        raise CaptureError(f"{owner}: depth_unit_scale_factor is {unit}; give the metres of one unit of the depth maps")
    return depth_map(
        find_photo(source.parent, str(name), source),
        find_photo(source.parent, str(confidence), source) if confidence else None,
        unit,
    )


def _lens(table: dict[str, object], owner: str, photo: Path) -> LensCamera:
    fisheye = table.get("camera_model") == "OPENCV_FISHEYE" or table.get("is_fisheye") is True
    model = table.get("camera_model", "OPENCV")
    if model not in _MODELS:
        raise CaptureError(f"{owner}: the camera model {model!r} is not supported; undistort the images to PINHOLE")
    coefficients = tuple(number_field(table, key, owner, 0.0) or 0.0 for key in (_FISHEYE if fisheye else _RADIAL))
    if fisheye:
        coefficients = coefficients[:4]
    elif not any(coefficients[5:]):
        coefficients = coefficients[:5]
    width, height = number_field(table, "w", owner), number_field(table, "h", owner)
    if not width or not height:
        width, height = photo_size(photo)
    fx, fy = number_field(table, "fl_x", owner), number_field(table, "fl_y", owner)
    if fx is None:
        angle = number_field(table, "camera_angle_x", owner)
        if angle is None or not MIN_ANGLE < angle < math.pi:
            raise CaptureError(f"{owner} has no focal length; write 'fl_x', or a 'camera_angle_x' between 0 and π")
        fx = 0.5 * width / math.tan(0.5 * angle)
    if fy is None:
        angle = number_field(table, "camera_angle_y", owner)
        # one angle alone means square pixels
        fy = 0.5 * height / math.tan(0.5 * angle) if angle and MIN_ANGLE < angle < math.pi else fx
    cx, cy = number_field(table, "cx", owner, width / 2), number_field(table, "cy", owner, height / 2)
    assert cx is not None and cy is not None
    return LensCamera(fx, fy, cx, cy, width, height, coefficients, "fisheye" if fisheye else "radial")


def _environment(content: dict[str, object], source: Path) -> EnvironmentSource | None:
    entry = content.get("environment")
    if entry is None:
        return None
    if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str):
        raise CaptureError(f"{source}: 'environment' needs an object with 'file_path' and 'strength'")
    strength = number_field(entry, "strength", f"{source}, environment", 1.0)
    assert strength is not None
    if strength < 0:
        raise CaptureError(f"{source}: the environment's strength {strength:g} is negative; use a positive number")
    # the file is not opened: a fit must not depend on it
    return EnvironmentSource(
        path=contained_path(source.parent, entry["file_path"], source),
        strength=strength,
        source_from_environment=BLENDER_FROM_LATLONG.copy(),
    )


def _text(frame: dict[str, object], key: str, source: Path, index: int) -> str:
    value = frame.get(key)
    if not isinstance(value, str):
        raise CaptureError(f"{source}, frame {index}: {key!r} is {value!r}, not a file name")
    return value
