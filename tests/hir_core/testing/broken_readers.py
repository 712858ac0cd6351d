"""Readers with further faults: what their pixels, cameras and splits are, and which folders they match."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hir_core.capture import Capture, Pixels
from tests.hir_core.testing.broken_inputs import Reader

HERE = __name__


@dataclass(frozen=True)
class Changed:
    """Pixels with another value in one field; picklable."""

    read: Callable[[], Pixels]
    field: str
    value: Any

    def __call__(self) -> Pixels:
        return replace(self.read(), **{self.field: self.value})


@dataclass(frozen=True)
class Widened:
    """Colours in double precision; picklable."""

    read: Callable[[], Pixels]

    def __call__(self) -> Pixels:
        pixels = self.read()
        return replace(pixels, color_linear=pixels.color_linear.astype(np.float64))


def with_saturated(capture: Capture, value: Any) -> Capture:
    views = [replace(view, read=Changed(view.read, "saturated", value)) for view in capture.views]
    return replace(capture, views=tuple(views))


class NoSaturation(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        return with_saturated(super().read(path, split), None)


class SaturationOfChannels(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        return with_saturated(super().read(path, split), np.zeros((48, 48, 3), bool))


class AllSaturated(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        return with_saturated(super().read(path, split), np.ones((48, 48), bool))


class DoublePrecision(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        capture = super().read(path, split)
        return replace(capture, views=tuple(replace(view, read=Widened(view.read)) for view in capture.views))


class OtherSize(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        capture = super().read(path, split)
        views = [replace(view, camera=replace(view.camera, width=2 * view.camera.width)) for view in capture.views]
        return replace(capture, views=tuple(views))


class ListOfViews(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        capture = super().read(path, split)
        return replace(capture, views=list(capture.views))  # type: ignore[arg-type]


class ReadsNothing(Reader):
    def read(self, path: Path, split: str = "train") -> Capture:
        super().read(path, split)
        return None  # type: ignore[return-value]


class SameSplits(Reader):
    def splits(self, path: Path) -> list[str]:
        return ["train", "test"]

    def read(self, path: Path, split: str = "train") -> Capture:
        return super().read(path, "train" if split == "test" else split)


class MatchesPictures(Reader):
    def matches(self, path: Path) -> bool:
        return super().matches(path) or any(path.glob("*.png"))


class MatchesJson(Reader):
    def matches(self, path: Path) -> bool:
        return super().matches(path) or any(path.glob("*.json"))
