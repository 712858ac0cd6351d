"""Finds the reader of a capture and reads one of its splits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.capture import Capture
from hir_core.errors import CaptureError

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import CaptureReader
    from hir_core.plugins.manager import PluginManager


def find_reader(path: Path, plugins: PluginManager, name: str = "auto") -> tuple[str, CaptureReader]:
    """The reader of that name, or the first installed one that knows the capture's format."""
    if not path.exists():
        raise CaptureError(f"{path} does not exist; give the folder of a capture")
    if name != "auto":
        return name, plugins.create("capture_reader", name)
    tried = []
    for registered in plugins.components("capture_reader"):
        if registered.missing:
            continue
        reader: CaptureReader = plugins.create("capture_reader", registered.component.name)
        if reader.matches(path):
            return registered.component.name, reader
        tried.append(f"{registered.component.name} ({registered.component.summary.rstrip('.')})")
    raise CaptureError(f"{path} is no capture that an installed reader knows; there are: {', '.join(tried) or 'none'}")


def read_capture(path: Path, split: str, plugins: PluginManager, reader: str = "auto") -> Capture:
    """Cameras and names of one split; the capture records which reader read it."""
    name, found = find_reader(path, plugins, reader)
    known = found.splits(path)
    if split not in known:
        raise CaptureError(f"{path} has no split {split!r}; it has: {', '.join(known) or 'none'}")
    try:
        return replace(found.read(path, split), reader=name)
    except OSError as error:  # such as a name in a file of cameras that is longer than the system takes
        raise CaptureError(f"{path} cannot be read as {name}: {error.strerror or error}") from error
