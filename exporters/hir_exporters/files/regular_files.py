"""Refuses what is not a regular file before it is opened: reading a pipe or a device of a stranger's folder blocks."""

from __future__ import annotations

import os
from pathlib import Path

from hir_exporters.errors import InputError


def check_regular_file(path: str | os.PathLike[str]) -> Path:
    """The path of a regular file; a folder, a pipe, a device or a missing file raises `InputError`."""
    file = Path(path)
    try:
        if file.is_file():
            return file
        if not file.exists():
            raise InputError(f"{file} does not exist")
    except (OSError, ValueError) as error:  # longer than the system allows, or characters that it does not allow
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{str(file)[:200]!r} cannot be opened: {reason}") from error
    raise InputError(f"{file} {'is a folder, not a file' if file.is_dir() else 'is not a regular file'}")


def refuse_special_file(path: Path) -> None:
    """Raises `InputError` for a pipe, a socket or a device; a missing file and a folder pass."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path} is not a regular file; remove it")
