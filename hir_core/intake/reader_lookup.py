"""Selects the reader of a capture and reads one of its splits."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.capture import Capture
from hir_core.errors import CaptureError, PluginError
from hir_core.files.file_names import check_text_path
from hir_core.plugins.registration import a_value

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import CaptureReader
    from hir_core.plugins.manager import PluginManager


def find_reader(path: Path, plugins: PluginManager, name: str = "auto") -> tuple[str, CaptureReader]:
    """The reader of that name, or with `auto` the first installed one that matches; readers of cameras come first,
    and of each kind they are asked in the order of their names.
    """
    if not path.exists():
        raise CaptureError(f"{path} does not exist; give the folder of a capture")
    if name != "auto":
        return name, plugins.create("capture_reader", name)
    tried = []
    readers = plugins.components("capture_reader")
    for registered in sorted(readers, key=lambda r: "without_cameras" in r.component.traits):
        if registered.missing:
            continue
        reader: CaptureReader = plugins.create("capture_reader", registered.component.name)
        if reader.matches(path):
            return registered.component.name, reader
        tried.append(registered.component.name)
    raise CaptureError(
        f"{path} is no capture that an installed reader knows ({', '.join(tried) or 'none is installed'}); give a "
        "folder with two photographs or more, with takes.toml and a folder for each take, or with the cameras of "
        "another program (docs/captures.md)"
    )


def _warn_of_other_readers(path: Path, plugins: PluginManager, used: str) -> None:
    """Says which reader is used where several match; those of photographs alone match beside each reader of cameras."""
    traits = plugins.find("capture_reader", used).component.traits
    others = [
        r.component.name
        for r in plugins.components("capture_reader")
        if r.component.name != used
        and not r.missing
        and ("without_cameras" in r.component.traits) == ("without_cameras" in traits)
        and plugins.create("capture_reader", r.component.name).matches(path)
    ]
    if others:
        warnings.warn(
            f"{path} is read as {used}, the first in the order of names; {', '.join(others)} could read it, too: "
            f'select one by --set reader="{others[0]}"',
            stacklevel=2,
        )


def read_capture(path: Path, split: str, plugins: PluginManager, reader: str = "auto") -> Capture:
    """The capture of one split, with the name of the reader."""
    check_text_path(path)
    name, selected = find_reader(path, plugins, reader)
    if reader == "auto":
        _warn_of_other_readers(path, plugins, name)
    known = selected.splits(path)
    if split not in known:
        if list(known) == ["train"]:
            raise CaptureError(
                f"{path} has no split {split!r}, only 'train', the photographs of the fit; "
                "docs/evaluation.md says how to keep photographs for a test"
            )
        raise CaptureError(f"{path} has no split {split!r}; use one of: {', '.join(known) or 'none'}")
    try:
        capture = selected.read(path, split)
    except OSError as error:  # for example a file name in a camera file that is too long for the system
        raise CaptureError(f"{path} cannot be read as {name}: {error.strerror or error}") from error
    if not isinstance(capture, Capture):
        raise PluginError(
            f"{plugins.find('capture_reader', name).label} returned {a_value(capture)} from read; return a Capture"
        )
    return replace(capture, reader=name)
