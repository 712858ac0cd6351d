"""Looks for a calibration beside the capture."""

from __future__ import annotations

from pathlib import Path

from hir_core.capture import Capture
from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import CaptureReader


class Curious(CaptureReader):
    def __init__(self, config: NoOptions) -> None:
        from hir_plugins.readers.transforms_json import TransformsJsonReader

        self.inner = TransformsJsonReader(config)

    def matches(self, path: Path) -> bool:
        return self.inner.matches(path)

    def splits(self, path: Path) -> list[str]:
        return self.inner.splits(path)

    def read(self, path: Path, split: str = "train") -> Capture:
        for file in path.parent.glob("*.txt"):
            file.read_text(encoding="utf-8", errors="replace")
        return self.inner.read(path, split)


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    written_by = "hir_plugins.readers.contract_inputs:transforms_json"
    return [Component("curious", f"{__name__}:Curious", summary="Transforms with a calibration.", testing=written_by)]
