"""A capture reader: the data sets of NSVF (Neural Sparse Voxel Fields), a text file for each pose.

hir check CAPTURE --plugin nsvf.py
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hir_exporters.conventions import Z_UP_TO_Y_UP, linear_to_srgb, srgb_to_linear

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.errors import CaptureError, InputError
from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import CaptureReader

SPLITS = {"train": "0_", "val": "1_", "test": "2_"}
"""How the names of a split's files begin."""


@dataclass(frozen=True)
class Photograph:
    """Reads a photograph when it is called; picklable."""

    path: Path

    def __call__(self) -> Pixels:
        from hir_exporters.textures.image_files import read_ldr

        try:
            encoded = read_ldr(self.path)
        except InputError as error:
            raise CaptureError(str(error)) from None
        mask = encoded[..., 3].astype(np.float32) if encoded.shape[2] == 4 else None
        color = encoded[..., :3]
        return Pixels(srgb_to_linear(color).astype(np.float32), mask, (color >= 254 / 255).any(axis=2))


class Nsvf(CaptureReader):
    """`intrinsics.txt` begins with the focal length and the principal point; `pose/NAME.txt` is 4×4, camera to world,
    x right, y down, z forward, the world's z up; the photograph is `rgb/NAME.png`.
    """

    def __init__(self, config: NoOptions) -> None: ...

    def matches(self, path: Path) -> bool:
        return (path / "intrinsics.txt").is_file() and (path / "pose").is_dir() and (path / "rgb").is_dir()

    def splits(self, path: Path) -> list[str]:
        return [split for split, start in SPLITS.items() if any((path / "pose").glob(f"{start}*.txt"))]

    def read(self, path: Path, split: str = "train") -> Capture:
        if split not in self.splits(path):
            raise CaptureError(f"{path} has no split {split!r}; it has {', '.join(self.splits(path)) or 'no poses'}")
        focal, center_x, center_y = _numbers(path, "intrinsics.txt")[:3]
        views = []
        for file in sorted((path / "pose").glob(f"{SPLITS[split]}*.txt")):
            pose = np.array(_numbers(path, f"pose/{file.name}")).reshape(-1)
            if pose.shape != (16,) or abs(np.linalg.det(pose.reshape(4, 4)[:3, :3]) - 1) > 0.01:
                raise CaptureError(f"{file} is no pose of 4×4 numbers; export the poses again")
            photo = _inside(path, f"rgb/{file.stem}.png")
            height, width = Photograph(photo)().color_linear.shape[:2]
            intrinsics = np.array([[focal, 0, center_x], [0, focal, center_y], [0, 0, 1]])
            views.append(
                View(
                    file.stem,
                    Camera(intrinsics, np.linalg.inv(pose.reshape(4, 4)), width, height),
                    Photograph(photo),
                    path=photo,
                )
            )
        world = np.eye(4)
        world[:3, :3] = Z_UP_TO_Y_UP
        return Capture(path, tuple(views), split=split, reader="nsvf").transformed(world)


def _inside(folder: Path, name: str) -> Path:
    """A file of the capture; a link that leads out of its folder is an error."""
    file = folder / name
    if not file.is_file() or not file.resolve().is_relative_to(folder.resolve()):
        raise CaptureError(f"{file} is missing, or leads out of the capture's folder; add the file")
    return file


def _numbers(folder: Path, name: str) -> list[float]:
    file = _inside(folder, name)
    try:
        numbers = [float(word) for word in file.read_text(encoding="utf-8").split()]
    except ValueError as error:
        raise CaptureError(f"{file} is no list of numbers ({error}); export the data set again") from None
    if len(numbers) < 3 or not np.isfinite(numbers).all():
        raise CaptureError(f"{file} has fewer than three numbers, or one that is not finite")
    return numbers


def write_sample(capture: Capture, folder: Path) -> Path:
    """For the contract tests: a capture in this format."""
    from hir_exporters.textures.image_files import write_png

    (folder / "pose").mkdir()
    z_up = np.eye(4)
    z_up[:3, :3] = Z_UP_TO_Y_UP.T
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True)):
        write_png(folder / "rgb" / f"0_{i:04}.png", linear_to_srgb(view.pixels().color_linear).astype(np.float32))
        np.savetxt(folder / "pose" / f"0_{i:04}.txt", z_up @ np.linalg.inv(camera.world_to_camera))
    k = capture.cameras[0].intrinsics
    (folder / "intrinsics.txt").write_text(f"{float(k[0, 0])!r} {float(k[0, 2])!r} {float(k[1, 2])!r} 0\n")
    return folder


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [
        Component(
            name="nsvf",
            target="hir_plugin_nsvf:Nsvf",
            summary="Reads data sets of NSVF: a text file for each pose.",
            testing="hir_plugin_nsvf:write_sample",
        )
    ]
