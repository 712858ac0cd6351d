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
    except (OSError, ValueError) as error:
        raise _refused_name(file, error) from error
    raise InputError(f"{file} {'is a folder, not a file' if file.is_dir() else 'is not a regular file'}")


def refuse_special_file(path: Path) -> None:
    """Raises `InputError` for a pipe, a socket or a device, and for a name that the system does not allow; a missing
    file and a folder pass.
    """
    try:
        is_special = path.exists() and not path.is_file() and not path.is_dir()
    except (OSError, ValueError) as error:
        raise _refused_name(path, error) from error
    if is_special:
        raise InputError(f"{path} is not a regular file; remove it")


def _refused_name(path: Path, error: OSError | ValueError) -> InputError:
    """A name is longer than the system allows, or has characters that it does not allow."""
    reason = getattr(error, "strerror", None) or error
    return InputError(f"{str(path)[:200]!r} cannot be opened: {reason}")
