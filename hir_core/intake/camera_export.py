"""Writes estimated cameras for other programs: transforms.json and COLMAP's text files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from hir_exporters.files.atomic import write_text_atomic

from hir_core.capture import Camera
from hir_core.capture.rotations import quaternion_from_rotation
from hir_core.errors import ConfigError
from hir_core.files.json_documents import json_text

FORMATS = ("transforms", "colmap")

_Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_OPENGL_FROM_OPENCV = np.diag([1.0, -1, -1, 1])


def export_cameras(
    cameras: Mapping[str, Camera],
    photographs: Mapping[str, Path],
    form: str,
    output: Path,
    takes: Mapping[str, str] | None = None,
) -> Path:
    """Writes cameras by name, with the paths of their photographs; returns the written file or folder.

    `transforms`: `output`/transforms.json (nerfstudio's fields; +Z up, cameras look along -z), with the `takes` that
    have a name. `colmap`: the folder `output`/sparse/0 with cameras.txt, images.txt and an empty points3D.txt; +Y up as
    in the run. Images are named by their files, or by their paths in the photographs' common folder if files of two
    folders have one name. A missing photograph, an unknown `form`, and files of other cameras in the same place raise
    `ConfigError`; nothing is overwritten.
    """
    missing = sorted(set(cameras) - set(photographs))
    if missing:
        raise ConfigError(
            f"the photograph {missing[0]}, whose camera the run estimated, is missing from the capture; restore its "
            "file"
        )
    files = {name: os.path.relpath(photographs[name], output) for name in cameras}
    if form == "transforms":
        frames = [_frame(cameras[name], files[name], (takes or {}).get(name, "")) for name in sorted(cameras)]
        _write_new(output, {"transforms.json": json_text({"camera_model": "OPENCV", "frames": frames})})
        return output / "transforms.json"
    if form == "colmap":
        folder = output / "sparse" / "0"
        lines, pictures = _colmap_lines(cameras, _image_names({name: photographs[name] for name in cameras}))
        first = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        header = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
        files_of_model = {
            "cameras.txt": first + "\n".join(lines) + "\n",
            "images.txt": header + "\n\n".join(pictures) + "\n\n",
            "points3D.txt": "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
        }
        _write_new(folder, files_of_model)
        return folder
    raise ConfigError(f"cameras cannot be written as {form!r}; use {' or '.join(FORMATS)}")


def _write_new(folder: Path, texts: Mapping[str, str]) -> None:
    """Writes text files by name; `ConfigError` before the first one where that would replace other cameras.

    COLMAP reads a .bin in place of the .txt beside it, so that is refused, too.
    """
    for name, text in texts.items():
        path, binary = folder / name, (folder / name).with_suffix(".bin")
        found = path if path.exists() else binary if binary.exists() else None
        if found is not None and (found == binary or not path.is_file() or path.read_bytes() != text.encode()):
            raise ConfigError(f"{found} exists; choose another folder with -o, or move the file away")
    for name, text in texts.items():
        write_text_atomic(folder / name, text)


def _image_names(photographs: Mapping[str, Path]) -> dict[str, str]:
    files = {name: path.name for name, path in photographs.items()}
    if len(set(files.values())) == len(set(photographs.values())):
        return files
    common = os.path.commonpath([path.parent for path in photographs.values()])
    return {name: path.relative_to(common).as_posix() for name, path in photographs.items()}


def _frame(camera: Camera, file: str, take: str) -> dict[str, object]:
    pose = _Z_UP_FROM_Y_UP @ np.linalg.inv(camera.world_to_camera) @ _OPENGL_FROM_OPENCV
    k = camera.intrinsics
    frame = {
        "file_path": Path(file).as_posix(),
        **({"take": take} if take else {}),
        "w": camera.width,
        "h": camera.height,
        "fl_x": float(k[0, 0]),
        "fl_y": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        "transform_matrix": pose.tolist(),
    }
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    return frame | {name: float(value) for name, value in zip(names, camera.distortion, strict=False)}


def _colmap_lines(cameras: Mapping[str, Camera], files: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Lines of cameras.txt (one for each photograph) and of images.txt."""
    lines, pictures = [], []
    for number, name in enumerate(sorted(cameras), start=1):
        camera = cameras[name]
        k = camera.intrinsics
        parameters = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        model = "PINHOLE"
        if any(camera.distortion):
            padded = [*camera.distortion, *([0.0] * 8)][:8]
            model = "OPENCV" if not any(padded[4:]) else "FULL_OPENCV"
            parameters += padded[: 4 if model == "OPENCV" else 8]
        numbers = " ".join(repr(float(p)) for p in parameters)
        lines.append(f"{number} {model} {camera.width} {camera.height} {numbers}")
        pose = [*quaternion_from_rotation(camera.world_to_camera[:3, :3]), *camera.world_to_camera[:3, 3]]
        pictures.append(f"{number} {' '.join(repr(float(p)) for p in pose)} {number} {files[name]}")
    return lines, pictures
