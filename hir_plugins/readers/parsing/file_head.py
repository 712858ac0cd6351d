"""The first bytes of a file, to recognise its format."""

from __future__ import annotations

from pathlib import Path

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
