"""File names that are valid on every platform."""

from __future__ import annotations

import os
import re

from hir_core.errors import InputError


def file_stem(name: str) -> str:
    """A file name that is valid on all systems, from any text."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "asset"


def check_text_path(path: str | os.PathLike[str]) -> None:
    """Raises `InputError` where a path is not text: on Linux any bytes may be a name, but no document can hold it."""
    try:
        os.fspath(path).encode()
    except UnicodeEncodeError:
        raise InputError(f"{os.fspath(path)!r} is not valid Unicode; rename the file or folder") from None


def on_one_line(text: str) -> str:
    """Text for a terminal: line ends and other control characters, and halves of characters, as escapes."""
    plain = text.encode("utf-8", "backslashreplace").decode()
    return "".join(c if c.isprintable() or c == " " else c.encode("unicode_escape").decode() for c in plain)
