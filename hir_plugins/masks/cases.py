"""What the contract tests of mask sources need to know (`Component.testing`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_exporters.images import write_png

from hir_core.capture import Capture

if TYPE_CHECKING:
    from hir_core.testing.captures import TinyCapture


def photographs_with_alpha(truth: TinyCapture, given: Capture, folder: Path) -> tuple[Capture, dict[str, Any]]:
    """The photographs with their coverage, as those with an alpha channel are read."""
    del given, folder
    return truth.capture, {}


def folder_of_masks(truth: TinyCapture, given: Capture, folder: Path) -> tuple[Capture, dict[str, Any]]:
    """Masks as pictures in a folder of the capture."""
    del folder
    for view, mask in zip(given.views, truth.masks, strict=True):
        write_png(truth.folder / "cut_out" / f"{view.name}.png", mask[..., None].repeat(3, axis=2))
    return given, {"path": "cut_out"}
