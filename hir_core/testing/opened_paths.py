"""Which paths Python code opens or lists, by Python's audit events (PEP 578)."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

EVENTS = ("open", "os.listdir", "os.scandir")

_recording: list[list[Path]] = []
_installed: list[bool] = []


@contextlib.contextmanager
def opened_paths() -> Iterator[list[Path]]:
    """The absolute paths that are opened or listed inside of the block, in this process; those that a library of C
    opens by itself are not among them.
    """
    if not _installed:  # an audit hook cannot be removed
        sys.addaudithook(_record)
        _installed.append(True)
    found: list[Path] = []
    _recording.append(found)
    try:
        yield found
    finally:
        _recording.remove(found)


def _record(event: str, arguments: tuple[Any, ...]) -> None:
    if _recording and event in EVENTS and arguments and isinstance(arguments[0], str | bytes | os.PathLike):
        path = Path(os.path.realpath(os.fsdecode(arguments[0])))
        for found in _recording:
            found.append(path)
