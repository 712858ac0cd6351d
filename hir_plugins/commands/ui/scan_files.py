"""The scan whose mesh a run of `hir ui` keeps: a file of the capture, or another one on this machine."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from hir_core.errors import InputError
from hir_core.files.contained_files import regular_file_within
from hir_core.files.file_names import check_text_path

SCAN_SUFFIXES: Final = (".glb", ".gltf", ".obj", ".ply")
"""Formats that hold texture coordinates."""
MAX_LISTED: Final = 50
MAX_DEPTH: Final = 3
MAX_FILES: Final = 20_000
"""Files of a capture's folder that are looked at."""


def scans_in(capture: Path) -> tuple[str, ...]:
    """Meshes in the folder of a capture, by their paths below it; none where the capture is one file."""
    found: list[str] = []
    seen = 0
    for folder, folders, files in os.walk(capture):
        below = Path(folder).relative_to(capture)
        folders[:] = sorted(f for f in folders if not f.startswith(".") and len(below.parts) < MAX_DEPTH)
        seen += len(files)
        if seen > MAX_FILES:
            break
        found += [(below / file).as_posix() for file in sorted(files) if Path(file).suffix.lower() in SCAN_SUFFIXES]
    return tuple(found[:MAX_LISTED])


def scan_file(text: str, capture: Path) -> Path:
    """The file that a user named: below the capture's folder, or by its whole path. `InputError` where it is none."""
    check_text_path(text)
    name = text.strip()
    if not name:
        raise InputError("name the scan whose mesh is to be kept: its file among the photographs, or its whole path")
    try:
        path = Path(name).expanduser()
        if not path.is_absolute():
            return regular_file_within(capture, capture / path) if capture.is_dir() else _missing(name)
        return path.resolve() if path.is_file() else _missing(name)
    except (InputError, OSError, RuntimeError, ValueError):
        return _missing(name)


def _missing(name: str) -> Path:
    raise InputError(f"{name[:200]} is no file on this machine; name the scan as .glb, .gltf, .obj or .ply")
