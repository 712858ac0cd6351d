"""What broken readers of this folder are made of: poses.txt with a camera in each line, and PNG files in images/."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hir_core.plugins import Component, NoOptions
from hir_core.plugins.interfaces import CaptureReader

NUMBERS = 4 + 16


@dataclass(frozen=True)
class Picture:
    """Reads a photograph; can be pickled."""

    path: Path

    def __call__(self) -> Any:
        from hir_exporters.conventions import srgb_to_linear
        from hir_exporters.textures.image_files import read_ldr

        from hir_core.capture import Pixels
        from hir_core.errors import CaptureError

        if not self.path.is_file():
            raise CaptureError(f"{self.path}: there is no such photograph; correct its name in poses.txt")
        color = srgb_to_linear(read_ldr(self.path)[..., :3]).astype(np.float32)
        return Pixels(color, None, np.zeros(color.shape[:2], bool))


class PosesReader(CaptureReader):
    def __init__(self, config: NoOptions) -> None: ...

    def matches(self, path: Path) -> bool:
        return (path / "poses.txt").is_file()

    def splits(self, path: Path) -> list[str]:
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Any:
        from hir_core.capture import Camera, Capture, View
        from hir_core.errors import CaptureError

        if split != "train":
            raise CaptureError(f"{path}: there is no split {split!r}; poses.txt describes 'train'")
        try:
            lines = (path / "poses.txt").read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise CaptureError(f"{path / 'poses.txt'} cannot be read as text: {error}") from error
        views = []
        for line in lines:
            name, *words = line.split()
            fx, fy, cx, cy, *pose = self.numbers(path, words)
            picture = Picture(self.place(path, name))
            height, width = picture().color_linear.shape[:2]
            intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            camera = Camera(intrinsics, np.array(pose).reshape(4, 4), width, height)
            views.append(View(Path(name).stem, camera, picture))
        if not views:
            raise CaptureError(f"{path / 'poses.txt'} describes no photograph; write one line for each")
        return Capture(path, tuple(views))

    def numbers(self, path: Path, words: list[str]) -> list[float]:
        """The finite numbers of a line."""
        from hir_core.errors import CaptureError

        try:
            numbers = [float(word) for word in words]
        except ValueError as error:
            raise CaptureError(f"{path / 'poses.txt'}: {error}") from error
        if len(numbers) != NUMBERS or not np.isfinite(numbers).all():
            raise CaptureError(f"{path / 'poses.txt'}: a line needs {NUMBERS} finite numbers after the name")
        return numbers

    def place(self, path: Path, name: str) -> Path:
        """The file of a photograph, inside of the capture."""
        from hir_core.errors import CaptureError

        found = (path / "images" / name).resolve()
        if not found.is_relative_to(path.resolve()):
            raise CaptureError(f"{path / 'poses.txt'} names {name}, which lies outside of the capture")
        return found


def written(capture: Any, folder: Path) -> Path:
    """A capture in this format."""
    from hir_exporters.conventions import linear_to_srgb
    from hir_exporters.textures.image_files import write_png

    lines = []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        write_png(folder / "images" / f"{view.name}.png", linear_to_srgb(view.pixels().color_linear).astype(np.float32))
        lens = camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]
        lines.append(
            " ".join([f"{view.name}.png", *(repr(float(n)) for n in (*lens, *camera.world_to_camera.ravel()))])
        )
    (folder / "poses.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def descriptor(target: str) -> Component:
    """A descriptor of a reader of this format."""
    return Component("poses_text", target, summary="Poses in a text file.", testing=f"{__name__}:written")
