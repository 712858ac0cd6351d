"""Readers and mask sources with one fault each."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hir_core.capture import Capture, Pixels
from hir_core.plugins import Component, NoOptions
from hir_core.plugins.interfaces import CaptureReader, MaskSource
from hir_plugins.masks.color_key import ColorKey
from hir_plugins.masks.options import ColorKeyOptions
from hir_plugins.readers.transforms_json import TransformsJsonReader

HERE = __name__


class Reader(CaptureReader):
    """The sound one: `transforms_json`."""

    def __init__(self, config: NoOptions) -> None:
        self.inner = TransformsJsonReader(config)

    def matches(self, path: Path) -> bool:
        return self.inner.matches(path)

    def splits(self, path: Path) -> list[str]:
        return self.inner.splits(path)

    def read(self, path: Path, split: str = "train") -> Capture:
        return self.inner.read(path, split)


class KnowsEverything(Reader):
    def matches(self, path: Path) -> bool:
        return path.is_dir()


class HalfAPixel(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        capture = super().read(path, split)
        off = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        views = [replace(v, camera=replace(v.camera, intrinsics=v.camera.intrinsics + off)) for v in capture.views]
        return replace(capture, views=tuple(views))


class Mirrored(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        return replace(super().read(path, split), world_from_source=np.diag([-1.0, 1.0, 1.0, 1.0]))


@dataclass(frozen=True)
class Darker:
    """Pixels that are taken for linear a second time; picklable."""

    read: Any

    def __call__(self) -> Pixels:
        pixels = self.read()
        return replace(pixels, color_linear=pixels.color_linear**2.2)


class TwiceDecoded(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        capture = super().read(path, split)
        return replace(capture, views=tuple(replace(v, read=Darker(v.read)) for v in capture.views))


class Trusting(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        if split == "train":
            json.loads((path / "transforms_train.json").read_text(encoding="utf-8"))["frames"]
        return super().read(path, split)


class Curious(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        for file in path.parent.glob("*.txt"):
            file.read_bytes()
        return super().read(path, split)


@dataclass(frozen=True)
class Quality:
    """Of a reader."""

    sharpness: float = 1.0
    """Nothing sets it."""


def reader(implementation: type = Reader, config: type = NoOptions, module: str = HERE) -> Component:
    return Component(
        "wrapped",
        f"{module}:{implementation.__name__}",
        config,
        summary="A reader, wrapped.",
        testing="hir_plugins.readers.contract_inputs:transforms_json",
    )


BROKEN_READERS: dict[str, Component] = {
    "reader_has_no_options": reader(config=Quality),
    "knows_its_own_format": reader(KnowsEverything),
    "cameras_are_where_they_were": reader(HalfAPixel),
    "source_axes_are_recorded": reader(Mirrored),
    "pixels_are_linear": reader(TwiceDecoded),
    "stays_in_its_folder": reader(Curious),
    "malformed_files_are_refused": reader(Trusting),
}


class Masks(MaskSource):
    """The sound one: `color_key`."""

    def __init__(self, config: NoOptions) -> None:
        self.inner = ColorKey(ColorKeyOptions())

    def masks(self, capture: Capture, scene: Any) -> list[Any]:
        return self.inner.masks(capture, scene)


class Inverted(Masks):
    def masks(self, capture: Capture, scene: Any) -> list[Any]:
        return [1 - mask for mask in super().masks(capture, scene)]


class NeedsOne(Masks):
    def masks(self, capture: Capture, scene: Any) -> list[Any]:
        capture.views[0].pixels()
        return super().masks(capture, scene)


class TupleOfMasks(Masks):
    def masks(self, capture: Capture, scene: Any) -> Any:
        return tuple(super().masks(capture, scene))


class NoMasks(Masks):
    def masks(self, capture: Capture, scene: Any) -> Any:
        return None


class NestedLists(Masks):
    def masks(self, capture: Capture, scene: Any) -> Any:
        return [mask.tolist() for mask in super().masks(capture, scene)]


class NeedsCameras(Masks):
    def masks(self, capture: Capture, scene: Any) -> list[Any]:
        if capture.cameras:
            return super().masks(capture, scene)
        return []


class NeedsPoints(Masks):
    def masks(self, capture: Capture, scene: Any) -> list[Any]:
        return super().masks(capture, scene) if capture.points is not None else [None] * len(capture.views)


class NoFiles(Masks):
    def files(self, capture: Capture) -> Any:
        return None


class MissingFiles(Masks):
    def files(self, capture: Capture) -> list[Path]:
        return [capture.path / "no_such_file.png"]


def mask_source(implementation: type = Masks, traits: frozenset[str] = frozenset()) -> Component:
    return Component("keyed", f"{HERE}:{implementation.__name__}", summary="Masks, wrapped.", traits=traits)


BROKEN_MASKS: dict[str, Component] = {
    "masks_are_the_true_ones": mask_source(Inverted),
    "unusable_photographs_are_refused": mask_source(NeedsOne),
}
