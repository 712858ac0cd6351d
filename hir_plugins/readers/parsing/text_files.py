"""Text files of a capture, from untrusted sources: their first bytes and their text."""

from __future__ import annotations

from pathlib import Path

from hir_exporters.files.regular_files import refuse_special_file

from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.capture_paths import MAX_TEXT_BYTES

HEAD_BYTES = 4096
"""What is read of a file to recognise its format."""


def file_head(path: Path) -> bytes:
    """The first bytes of a regular file; empty if it cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError:
        return b""


def read_text(path: Path) -> str:
    """The text of a regular file of limited size; bytes that are not UTF-8 become replacement characters."""
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise CaptureError(f"{path} is larger than {MAX_TEXT_BYTES >> 20} MB; it is not a camera file")
    refuse_special_file(path)
    return path.read_text(encoding="utf-8-sig", errors="replace")
