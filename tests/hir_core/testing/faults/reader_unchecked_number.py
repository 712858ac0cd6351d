"""Checks the poses, and not the focal lengths."""

from __future__ import annotations

from pathlib import Path

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound_reader import PosesReader, descriptor


class Trusting(PosesReader):
    def numbers(self, path: Path, words: list[str]) -> list[float]:
        numbers = super().numbers(path, ["1", "1", *words[2:]])
        return [*map(float, words[:2]), *numbers[2:]]


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [descriptor(f"{__name__}:Trusting")]
