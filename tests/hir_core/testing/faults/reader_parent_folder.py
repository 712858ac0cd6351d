"""Follows `../` out of the capture."""

from __future__ import annotations

from pathlib import Path

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound_reader import PosesReader, descriptor


class Trusting(PosesReader):
    def place(self, path: Path, name: str) -> Path:
        return path / "images" / name


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [descriptor(f"{__name__}:Trusting")]
