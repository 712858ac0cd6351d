"""Addresses of files and folders, on this machine or in an object store."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem


@dataclass(frozen=True)
class FileStat:
    """What a listing says about a file without reading it."""

    size: int
    """Bytes."""
    version: str
    """The store's checksum or version if it has one, otherwise the time of the last change."""


@dataclass(frozen=True)
class StoragePath:
    """A file or a folder: a path of this machine, or a URL such as `s3://bucket/folder`."""

    url: str

    def __truediv__(self, name: str) -> StoragePath:
        return StoragePath(f"{self.url.rstrip('/')}/{name}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        """The last part of the address."""
        return self.url.rstrip("/").rpartition("/")[2]

    @property
    def protocol(self) -> str:
        """Such as `s3`; empty for a path of this machine."""
        protocol, separator, _ = self.url.partition("://")
        return protocol if separator else ""

    @property
    def local(self) -> Path | None:
        """The path on this machine's file system; None for an object store."""
        if not self.protocol:
            return Path(self.url)
        return Path(self.url.partition("://")[2]) if self.protocol in ("file", "local") else None

    def open(self) -> tuple[AbstractFileSystem, str]:
        """fsspec's file system and the path in it.

        Raises `MissingExtraError` if a package for the protocol is missing, `InputError` if the URL is invalid.
        """
        try:
            import fsspec
        except ImportError:
            raise MissingExtraError("hir batch needs fsspec; install it with: pip install 'hir[batch]'") from None
        try:
            file_system, path = fsspec.url_to_fs(self.url)
        except ImportError as error:
            extra = {"s3": "batch-s3", "s3a": "batch-s3", "gs": "batch-gs", "gcs": "batch-gs"}.get(self.protocol)
            advice = f"; install it with: pip install 'hir[{extra}]'" if extra else f" ({error})"
            raise MissingExtraError(f"{self.url} needs another package{advice}") from None
        except ValueError as error:
            raise InputError(f"{self.url} cannot be opened: {error}") from None
        return file_system, path


def parse_storage_path(text: str) -> StoragePath:
    """The address that a user wrote; a local path is made absolute. `InputError` for one that names no place."""
    if not text.strip():
        raise InputError("an address is empty; give a folder or a URL, or . for the current folder")
    protocol, separator, rest = text.partition("://")
    if separator:
        if not protocol or not rest.strip("/"):
            raise InputError(f"{text} names no folder; write it as s3://BUCKET/FOLDER")
        return StoragePath(text.rstrip("/"))
    try:
        return StoragePath(str(Path(text).expanduser().resolve()))
    except RuntimeError:  # ~NAME of an unknown user
        raise InputError(f"{text}: there is no user {text[1:].partition('/')[0]!r}; give the whole path") from None
