"""Files and folders that appear complete or not at all.

Everything is written to a temporary neighbour, flushed to the disk and renamed into place. Operating system errors
(a full disk, a read-only folder, a folder where a file should go) become `ExportError` naming the destination.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from hir_exporters.errors import ExportError

_TEMPORARY_PREFIX = ".hir-partial-"


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`, with its suffix, for a library to write to; rename it when the block ends.

    Missing parent folders are made. When the block raises, nothing is left behind and an older file stays as it was.
    """
    destination = Path(path)
    temporary = destination.with_name(f"{_TEMPORARY_PREFIX}{secrets.token_hex(8)}{destination.suffix}")
    with _named_errors(destination):
        if destination.is_dir():
            raise ExportError(f"cannot write {destination}: a folder of that name is in the way; choose another name")
        destination.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            _flush_file(temporary)
            os.replace(temporary, destination)
        finally:
            temporary.unlink(missing_ok=True)
        _flush_folder(destination.parent)


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yield a binary file that becomes `path` when the block ends without an error."""
    with atomic_path(path) as temporary, open(temporary, "xb") as stream:
        yield stream


def write_bytes_atomic(path: str | os.PathLike[str], data: bytes | bytearray | memoryview) -> None:
    """Make `path` hold exactly `data`, or raise `ExportError` and leave it as it was."""
    with atomic_write(path) as stream:
        stream.write(data)


def write_text_atomic(path: str | os.PathLike[str], text: str) -> None:
    """UTF-8 with `\\n` line ends on every system, so that the bytes do not depend on where they are written."""
    write_bytes_atomic(path, text.encode("utf-8"))


@contextlib.contextmanager
def atomic_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield an empty folder beside `path` that takes its place when the block ends without an error.

    An older folder of that name is replaced as a whole. A file of that name is an `ExportError`.
    """
    destination = Path(path)
    token = secrets.token_hex(8)
    temporary = destination.with_name(f"{_TEMPORARY_PREFIX}{token}")
    replaced = destination.with_name(f"{_TEMPORARY_PREFIX}{token}-old")
    with _named_errors(destination):
        if destination.exists() and not destination.is_dir():
            raise ExportError(f"cannot make the folder {destination}: a file of that name is in the way")
        destination.parent.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
        try:
            yield temporary
            for file in sorted(temporary.rglob("*")):
                if file.is_file():
                    _flush_file(file)
            if destination.is_dir():
                # A folder cannot be renamed onto one that has entries: step the old one aside first.
                os.replace(destination, replaced)
                try:
                    os.replace(temporary, destination)
                except OSError:
                    os.replace(replaced, destination)
                    raise
            else:
                os.replace(temporary, destination)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
            shutil.rmtree(replaced, ignore_errors=True)
        _flush_folder(destination.parent)


def is_partial(path: Path) -> bool:
    """Is it something that was being written when its process ended?"""
    return path.name.startswith(_TEMPORARY_PREFIX)


def remove_partials(folder: Path) -> int:
    """Removes what a process that was killed left below a folder; only for a folder that nobody writes to. Returns how
    many.
    """
    partials = sorted(folder.rglob(f"{_TEMPORARY_PREFIX}*"))
    for partial in partials:
        if partial.is_dir() and not partial.is_symlink():
            shutil.rmtree(partial, ignore_errors=True)
        else:
            partial.unlink(missing_ok=True)
    return len(partials)


@contextlib.contextmanager
def _named_errors(destination: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise ExportError(
            f"cannot write {destination}: {reason}; check the folder, its rights and free space"
        ) from error


def _flush_file(path: Path) -> None:
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())


def _flush_folder(folder: Path) -> None:
    if os.name != "posix":  # only POSIX systems let a folder be opened, and need it for the rename to be durable
        return
    with contextlib.suppress(OSError):  # some network file systems refuse; the file itself is already safe
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
