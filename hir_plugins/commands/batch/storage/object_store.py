"""Reads and writes files on any fsspec file system: requests are retried, files are written as a whole."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

from hir_exporters.files.atomic import write_bytes_atomic

from hir_core.errors import InputError
from hir_plugins.commands.batch.retries import StoreError, Value, call_with_retries, one_line
from hir_plugins.commands.batch.storage.storage_path import FileStat, StoragePath

MAX_PARALLEL_TRANSFERS: Final = 16

ATOMIC_PROTOCOLS: Final = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oci", "memory"})
"""Protocols on which an object appears once its last byte has arrived, or not at all."""


def list_files(path: StoragePath) -> dict[str, FileStat]:
    """Relative name → stat of every file below a folder, sorted by name.

    For a file the result is one entry with an empty name; for a path that does not exist it is empty.
    """
    file_system, location = path.open()

    def listing() -> dict[str, FileStat]:
        file_system.invalidate_cache()
        found = file_system.find(location, detail=True)
        root = file_system._strip_protocol(location).rstrip("/")
        return {name[len(root) :].lstrip("/"): _file_stat(info) for name, info in sorted(found.items())}

    with contextlib.suppress(FileNotFoundError):
        return call_with_retries(listing, f"{path} cannot be listed")
    return {}


def read(path: StoragePath) -> bytes | None:
    """The content of a file; None if it does not exist."""
    file_system, location = path.open()
    try:
        return bytes(call_with_retries(lambda: file_system.cat_file(location), f"{path} cannot be read"))
    except FileNotFoundError:
        return None


def exists(path: StoragePath) -> bool:
    """Whether there is a file or a folder."""
    file_system, location = path.open()

    def found() -> bool:
        file_system.invalidate_cache()
        try:
            file_system.info(location)
        except FileNotFoundError:
            return False
        return True

    return call_with_retries(found, f"{path} cannot be accessed")


def write(path: StoragePath, content: bytes) -> None:
    """Replaces the content of a file; readers see the old content or the new one, never a part."""
    file_system, location = path.open()
    if path.local is not None:
        write_bytes_atomic(path.local, content)
        return

    def put() -> None:
        if path.protocol in ATOMIC_PROTOCOLS:
            file_system.pipe_file(location, content)
            return
        temporary = f"{location}.{secrets.token_hex(8)}"
        file_system.makedirs(location.rpartition("/")[0], exist_ok=True)
        file_system.pipe_file(temporary, content)
        file_system.mv(temporary, location)

    _write_with_retries(put, f"{path} cannot be written")


def create(path: StoragePath, content: bytes) -> bool:
    """Creates a file; returns False if it exists already.

    On a store without conditional writes, existence is checked before the write, so two writers may both succeed.
    """
    file_system, location = path.open()

    def put() -> bool:
        try:
            if path.local is None:
                file_system.pipe_file(location, content, mode="create")
            else:
                path.local.parent.mkdir(parents=True, exist_ok=True)
                with path.local.open("xb") as stream:
                    stream.write(content)
        except FileExistsError:
            return False
        return True

    return _write_with_retries(put, f"{path} cannot be created")


def remove(path: StoragePath) -> None:
    """Removes a file or a folder with its content, if it exists."""
    file_system, location = path.open()

    def delete() -> None:
        file_system.invalidate_cache()
        with contextlib.suppress(FileNotFoundError):
            file_system.rm(location, recursive=True)

    call_with_retries(delete, f"{path} cannot be removed")


def download(path: StoragePath, listing: Mapping[str, FileStat], target: Path) -> None:
    """Copies the listed files of `path` below the folder `target`, or the file `path` itself to `target`.

    Sizes are compared with the listing. Raises `StoreError` if a file disappears meanwhile.
    """
    file_system, location = path.open()

    def transfer(name: str) -> None:
        destination = target / name if name else target
        destination.parent.mkdir(parents=True, exist_ok=True)
        source, address = (f"{location}/{name}", path / name) if name else (location, path)

        def get() -> None:
            file_system.get_file(source, str(destination))
            size = destination.stat().st_size
            if size != listing[name].size:
                raise OSError(f"received {size} of {listing[name].size} bytes")

        try:
            call_with_retries(get, f"{address} cannot be read")
        except FileNotFoundError:
            raise StoreError(f"{address} was removed while its capture was being read") from None

    _in_parallel(transfer, list(listing))


def upload(sources: Mapping[str, Path], path: StoragePath) -> None:
    """Copies local files below a folder of a store, by relative name."""
    file_system, location = path.open()
    if path.protocol not in ATOMIC_PROTOCOLS:  # object stores have no folders
        for folder in sorted({f"{location}/{name}".rpartition("/")[0] for name in sources}):
            _write_with_retries(partial(file_system.makedirs, folder, exist_ok=True), f"{folder} cannot be created")

    def transfer(name: str) -> None:
        put = partial(file_system.put_file, str(sources[name]), f"{location}/{name}")
        _write_with_retries(put, f"{path / name} cannot be written")

    _in_parallel(transfer, list(sources))


def _write_with_retries(call: Callable[[], Value], failure: str) -> Value:
    """`call_with_retries` for a write, where a missing file means a missing bucket or disk."""
    try:
        return call_with_retries(call, failure)
    except FileNotFoundError as error:
        raise InputError(f"{failure}: {one_line(error)}; does the bucket or disk exist?") from error


def _in_parallel(transfer: Callable[[str], None], names: Sequence[str]) -> None:
    with ThreadPoolExecutor(MAX_PARALLEL_TRANSFERS) as pool:
        for future in [pool.submit(transfer, name) for name in names]:
            future.result()


def _file_stat(info: Mapping[str, Any]) -> FileStat:
    """From fsspec's listing: the checksum or version of an object, otherwise the modification time."""
    for key in ("ETag", "etag", "md5Hash", "content_md5", "version_id", "generation"):
        if info.get(key):
            return FileStat(int(info["size"]), str(info[key]).strip('"'))
    for key in ("mtime", "LastModified", "last_modified", "updated", "created"):
        if info.get(key):
            return FileStat(int(info["size"]), repr(info[key]))
    return FileStat(int(info.get("size") or 0), "")
