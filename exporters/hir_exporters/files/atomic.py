"""Atomic writes: files and folders appear complete or not at all.

Data is written to a temporary file in the same folder, flushed to disk and renamed. Operating system errors (a full
disk, a read-only folder, a folder of the same name) become `ExportError` with the destination in the message.
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
    """Yields a temporary path beside `path`, with the same suffix; renames it to `path` when the block ends.

    Missing parent folders are created. When the block raises, the temporary file is deleted and an older file of that
    name is not changed.
    """
    destination = Path(path)
    temporary = destination.with_name(f"{_TEMPORARY_PREFIX}{secrets.token_hex(8)}{destination.suffix}")
    with _named_errors(destination):
        _check_replaceable(destination)
        destination.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            _flush_file(temporary)
            os.replace(temporary, destination)
        finally:
            temporary.unlink(missing_ok=True)
        _flush_folder(destination.parent)


def move_atomic(source: Path, destination: Path) -> None:
    """Renames a file of the same file system to `destination`, with the checks of `atomic_path`."""
    with _named_errors(destination):
        _check_replaceable(destination)
        os.replace(source, destination)
        _flush_folder(destination.parent)


@contextlib.contextmanager
def staging_folder(folder: Path) -> Iterator[Path]:
    """Yields an empty temporary folder inside `folder`, which is created; it is deleted when the block ends."""
    temporary = folder / f"{_TEMPORARY_PREFIX}{secrets.token_hex(8)}"
    if folder.exists() and not folder.is_dir():
        raise ExportError(f"cannot create the folder {folder}: a file of that name exists; choose another folder")
    with _named_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yields a binary file that becomes `path` when the block ends without an error."""
    with atomic_path(path) as temporary, open(temporary, "xb") as stream:
        yield stream


def write_bytes_atomic(path: str | os.PathLike[str], data: bytes | bytearray | memoryview) -> None:
    """Replaces the content of `path` by `data`, or raises `ExportError` and changes nothing."""
    with atomic_write(path) as stream:
        stream.write(data)


def write_text_atomic(path: str | os.PathLike[str], text: str) -> None:
    """Writes UTF-8 with `\\n` line ends on every operating system."""
    write_bytes_atomic(path, text.encode("utf-8"))


@contextlib.contextmanager
def atomic_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields an empty folder beside `path` that replaces it when the block ends without an error.

    An older folder of that name is replaced as a whole. A file of that name raises `ExportError`.
    """
    destination = Path(path)
    token = secrets.token_hex(8)
    temporary = destination.with_name(f"{_TEMPORARY_PREFIX}{token}")
    replaced = destination.with_name(f"{_TEMPORARY_PREFIX}{token}-old")
    with _named_errors(destination):
        if destination.exists() and not destination.is_dir():
            raise ExportError(f"cannot create the folder {destination}: a file of that name exists")
        destination.parent.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
        try:
            yield temporary
            for file in sorted(temporary.rglob("*")):
                if file.is_file():
                    _flush_file(file)
            if destination.is_dir():
                # A folder cannot be renamed onto a folder that has entries: rename the old one first.
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
    """Whether the file or folder is the temporary one of a write that did not finish."""
    return path.name.startswith(_TEMPORARY_PREFIX)


def remove_partials(folder: Path) -> int:
    """Deletes the temporary files of killed processes below a folder and returns their number.

    Call it only for a folder that no process writes to.
    """
    partials = sorted(folder.rglob(f"{_TEMPORARY_PREFIX}*"))
    for partial in partials:
        if partial.is_dir() and not partial.is_symlink():
            shutil.rmtree(partial, ignore_errors=True)
        else:
            partial.unlink(missing_ok=True)
    return len(partials)


def _check_replaceable(destination: Path) -> None:
    """Raises `ExportError` for a folder, a device or a pipe: a rename would put a file in its place."""
    if destination.is_dir():
        raise ExportError(f"cannot write {destination}: a folder of that name exists; choose another name")
    if destination.exists() and not destination.is_file():
        raise ExportError(f"cannot write {destination}: it is not a regular file; choose another name")


@contextlib.contextmanager
def _named_errors(destination: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise ExportError(
            f"cannot write {destination}: {reason}; check that the folder exists, its permissions and free space"
        ) from error


def _flush_file(path: Path) -> None:
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())


def _flush_folder(folder: Path) -> None:
    if os.name != "posix":  # only POSIX systems can open a folder, and only they need it for a durable rename
        return
    with contextlib.suppress(OSError):  # some network file systems refuse; the file itself is already on disk
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
