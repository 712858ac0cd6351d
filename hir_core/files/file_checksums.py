"""BLAKE2 hashes of files: what a run wrote is compared with what is on disk before it is used again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from hir_exporters.files.regular_files import refuse_special_file

from hir_core.errors import InputError


def file_hash(path: Path) -> str:
    """Hash of a file's bytes; one that cannot be read is an `InputError` that names it."""
    refuse_special_file(path)
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "blake2b").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error


def checksums(root: Path, paths: Iterable[Path]) -> dict[str, str]:
    """The hash of each file, by its path relative to `root`, with `/` between folders."""
    return {path.relative_to(root).as_posix(): file_hash(path) for path in sorted(paths)}


def regular_files(folder: Path, skipped: str = "") -> Iterator[Path]:
    """Files below a folder; no links, no hidden files, and nothing below the entry `skipped` of the folder itself."""
    for path in folder.rglob("*"):
        below = path.relative_to(folder).parts
        if below[0] != skipped and not path.name.startswith(".") and path.is_file() and not path.is_symlink():
            yield path


def changed_file(root: Path, expected: Mapping[str, str]) -> str | None:
    """One sentence part about the first file that is missing or whose bytes changed; None where all are as written."""
    for name, written in expected.items():
        relative, path = PurePosixPath(name), root / name
        if relative.is_absolute() or ".." in relative.parts:
            return f"{name} is not a file of the run"
        if not path.exists():
            return f"{path} is missing"
        if path.is_symlink() or not path.is_file():
            return f"{path} is not a regular file"
        if file_hash(path) != written:
            return f"{path} has changed since it was written"
    return None
