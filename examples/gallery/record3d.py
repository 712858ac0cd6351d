"""A capture reader: what the app Record3D exports (an unpacked .r3d), ARKit's cameras with photographs.

hir check CAPTURE --plugin record3d.py
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.errors import CaptureError, InputError
from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import CaptureReader

MOST_VIEWS = 120
"""A video has sixty frames a second, which show nearly the same: at most this many are read, evenly spread."""


@dataclass(frozen=True)
class Photograph:
    """Reads a photograph when it is called; picklable."""

    path: Path

    def __call__(self) -> Pixels:
        from hir_exporters.textures.image_files import read_ldr

        try:
            encoded = read_ldr(self.path)[..., :3]
        except InputError as error:
            raise CaptureError(str(error)) from None
        return Pixels(srgb_to_linear(encoded).astype(np.float32), None, (encoded >= 254 / 255).any(axis=2))


class Record3D(CaptureReader):
    """`metadata` (JSON): w and h; K, 3×3 by columns; poses, a list of quaternion x y z w and camera centre, camera to
    world, x right, y up, z back, the world's y up, metres. The photographs are `rgbd/0.jpg`, `rgbd/1.jpg` and so on.
    """

    def __init__(self, config: NoOptions) -> None: ...

    def matches(self, path: Path) -> bool:
        return (path / "metadata").is_file() and (path / "rgbd").is_dir()

    def splits(self, path: Path) -> list[str]:
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        source = path / "metadata"
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; it has only 'train'")
        try:
            document = json.loads(source.read_text(encoding="utf-8"))
            width, height = int(document["w"]), int(document["h"])
            intrinsics = np.array(document["K"], dtype=np.float64).reshape(3, 3).T
            poses = np.array(document["poses"], dtype=np.float64).reshape(-1, 7)
        except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
            raise CaptureError(f"{source} is not Record3D's metadata ({error!r}); export the capture again") from None
        lengths = np.linalg.norm(poses[:, :4], axis=1)
        if not (np.isfinite(poses).all() and np.isfinite(intrinsics).all() and (lengths > 0).all()):
            raise CaptureError(f"{source} holds a camera that is not finite or has no direction; export it again")
        views = []
        for i in range(0, len(poses), -(-len(poses) // MOST_VIEWS) or 1):
            photo = path / "rgbd" / f"{i}.jpg"
            if not photo.is_file():
                raise CaptureError(f"{photo} is missing, though {source} has a pose for it; export the capture again")
            camera = Camera(intrinsics, _world_to_camera(poses[i]), width, height)
            views.append(View(f"{i:05}", camera, Photograph(photo), path=photo))
        return Capture(path, tuple(views), reader="record3d")


def _world_to_camera(pose: np.ndarray) -> np.ndarray:
    """OpenCV's matrix of a pose of ARKit."""
    from scipy.spatial.transform import Rotation

    camera_to_world = Rotation.from_quat(pose[:4]).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera_to_world.T, -camera_to_world.T @ pose[4:]
    return matrix


def write_sample(capture: Capture, folder: Path) -> Path:
    """For the contract tests: a capture in this format. The photographs are PNG inside, for
    JPEG would change their colours.
    """
    from hir_exporters.textures.image_files import write_png
    from scipy.spatial.transform import Rotation

    poses: list[list[float]] = []
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True)):
        write_png(folder / "picture.png", linear_to_srgb(view.pixels().color_linear).astype(np.float32))
        (folder / "rgbd").mkdir(exist_ok=True)
        (folder / "picture.png").rename(folder / "rgbd" / f"{i}.jpg")
        rotation = camera.world_to_camera[:3, :3].T @ np.diag([1.0, -1.0, -1.0])
        poses.append([*Rotation.from_matrix(rotation).as_quat(), *camera.center])
    first = capture.cameras[0]
    document: dict[str, Any] = {"w": first.width, "h": first.height, "poses": poses}
    document["K"] = first.intrinsics.T.ravel().tolist()
    (folder / "metadata").write_text(json.dumps(document), encoding="utf-8")
    return folder


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [
        Component(
            name="record3d",
            target="hir_plugin_record3d:Record3D",
            summary="Reads an unpacked capture of the app Record3D.",
            requires=("scipy",),
            extra="reconstruct",
            testing="hir_plugin_record3d:write_sample",
        )
    ]
