"""A capture that a browser sends: its list of files is checked first, then each file is streamed to disk."""

from __future__ import annotations

import contextlib
import os
import shutil
import threading
import time
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Final

from hir_core.errors import InputError

MAX_FILES: Final = 20_000
MAX_BYTES: Final = 256 << 30
MAX_DEPTH: Final = 8
MAX_NAME_BYTES: Final = 200
FREE_BYTES_KEPT: Final = 2 << 30
"""Space on the disk that an upload leaves for the run."""
BLOCK_BYTES: Final = 1 << 20
"""An upload needs this much memory for each connection."""

RESERVED_NAMES: Final = frozenset(
    {"con", "prn", "aux", "nul"} | {f"{port}{number}" for port in ("com", "lpt") for number in range(10)}
)
"""Names of devices on Windows, with any suffix."""


@dataclass(frozen=True)
class UploadedFile:
    """One entry of the list: a path below the capture's folder, and a size in bytes."""

    path: PurePosixPath
    size: int


@dataclass(frozen=True)
class Manifest:
    """The name of a capture and its files. Paths are relative, contained and different on every system."""

    name: str
    files: tuple[UploadedFile, ...]

    @property
    def total_bytes(self) -> int:
        return sum(file.size for file in self.files)


def parse_manifest(document: Mapping[str, Any]) -> Manifest:
    """`{"name", "files": [{"path", "size"}]}`; `InputError` names what may not be uploaded, and why."""
    name, entries = document.get("name"), document.get("files")
    if not isinstance(name, str) or not isinstance(entries, list):
        raise InputError("the list of files is not complete; load the page again")
    if not entries:
        raise InputError("the folder holds no files")
    if len(entries) > MAX_FILES:
        raise InputError(
            f"the folder holds more than {MAX_FILES:,} files; choose the folder of one capture, or type its path"
        )
    files = tuple(_parse_file(entry) for entry in entries)
    _refuse_collisions(files)
    manifest = Manifest(capture_name(name), files)
    if manifest.total_bytes > MAX_BYTES:
        raise InputError("the folder holds too many bytes; type its path instead: then nothing is copied")
    return manifest


def capture_name(name: str) -> str:
    """A plain folder name from any text, at most 64 letters long."""
    plain = "".join(c if c.isalnum() or c in "-_." else "-" for c in unicodedata.normalize("NFC", name).strip())
    plain = plain.strip("-.")[:48].rstrip("-.")
    return plain if plain and not _is_reserved(plain) else "capture"


def contained_path(text: str) -> PurePosixPath:
    """A relative path whose every part is a plain, visible name on all systems; anything else is an `InputError`.

    Names are not changed, because other files of a capture refer to them.
    """
    parts = text.split("/")
    if len(parts) > MAX_DEPTH:
        raise InputError(f"{text[:80]!r} lies deeper than {MAX_DEPTH} folders; choose the folder of one capture")
    for part in parts:
        wrong = (
            not part
            or part[0] == "."
            or part[-1] in ". "
            or any(c in '\\:*?"<>|' or not (c.isprintable() or c == "\u200d") for c in part)
            or _is_reserved(part)
            or len(part.encode("utf-8", "surrogatepass")) > MAX_NAME_BYTES
        )
        if wrong:
            raise InputError(f"{text[:80]!r} is not a file name that can be copied; rename the file, or type the path")
    return PurePosixPath(*parts)


class Upload:
    """The files of a manifest on their way into `folder`, which is the upload's own."""

    def __init__(self, manifest: Manifest, folder: Path) -> None:
        free = shutil.disk_usage(folder.parent).free
        if manifest.total_bytes > free - FREE_BYTES_KEPT:
            raise InputError(
                f"the folder holds {manifest.total_bytes / 1e9:.1f} GB, and the disk of {folder.parent} has "
                f"{free / 1e9:.1f} GB free, of which the run needs {FREE_BYTES_KEPT / 1e9:.1f} GB; type the folder's "
                "path instead: then nothing is copied"
            )
        self.manifest = manifest
        self.folder = folder
        self._changes = threading.Lock()
        self._arriving: set[int] = set()
        self._received: set[int] = set()
        self._used = time.monotonic()
        folder.mkdir()

    @property
    def idle_seconds(self) -> float:
        """Since anything arrived."""
        return time.monotonic() - self._used

    def receive(self, index: int, stream: BinaryIO, length: int) -> None:
        """Writes the file of that index. It is complete or absent; `InputError` where it may not be sent (again)."""
        if not 0 <= index < len(self.manifest.files):
            raise InputError("a file was sent that the list does not contain; load the page again")
        file = self.manifest.files[index]
        if length != file.size:
            raise InputError(f"{file.path} has changed since it was chosen; choose the folder again")
        with self._changes:
            if index in self._arriving | self._received:
                raise InputError(f"{file.path} was sent twice; load the page again")
            self._arriving.add(index)
        try:
            self._write(self.folder / file.path, stream, length)
            self._received.add(index)
        finally:
            self._arriving.discard(index)

    def finish(self, destination: Path) -> None:
        """Moves the complete folder; `InputError` where files are missing."""
        missing = len(self.manifest.files) - len(self._received)
        if missing or self._arriving:
            raise InputError(f"{missing} files have not arrived; choose the folder again")
        os.replace(self.folder, destination)

    def discard(self) -> None:
        """Removes what arrived."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _write(self, path: Path, stream: BinaryIO, length: int) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "xb") as target:
                left = length
                while left:
                    block = stream.read(min(BLOCK_BYTES, left))
                    if not block:
                        raise InputError(f"{path.name} arrived incomplete; choose the folder again")
                    target.write(block)
                    left -= len(block)
                    self._used = time.monotonic()
        except BaseException as error:
            with contextlib.suppress(OSError):
                path.unlink()
            if isinstance(error, OSError) and not isinstance(error, ConnectionError | TimeoutError):
                raise InputError(
                    f"{path.name} cannot be written to {self.folder.parent}: {error.strerror}; free some space, or "
                    "type the folder's path instead: then nothing is copied"
                ) from error
            raise


def _parse_file(entry: object) -> UploadedFile:
    if not isinstance(entry, dict) or not isinstance(entry.get("path"), str):
        raise InputError("the list of files is not complete; load the page again")
    size = entry.get("size")
    if not isinstance(size, int) or isinstance(size, bool) or size < 0:
        raise InputError(f"{entry['path'][:80]!r} has no size; load the page again")
    return UploadedFile(contained_path(entry["path"]), size)


def _refuse_collisions(files: tuple[UploadedFile, ...]) -> None:
    """Two names that are one on some system, or a name that is a file and a folder."""
    seen: set[str] = set()
    folders: set[str] = set()
    for file in files:
        folded = [_folded(part) for part in file.path.parts]
        path = "/".join(folded)
        if path in seen:
            raise InputError(f"{str(file.path)!r} occurs twice, but for upper and lower case; rename one of them")
        seen.add(path)
        folders |= {"/".join(folded[:depth]) for depth in range(1, len(folded))}
    if both := seen & folders:
        raise InputError(f"{sorted(both)[0]!r} is a file and a folder; rename one of them")


def _folded(part: str) -> str:
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", part).casefold())


def _is_reserved(part: str) -> bool:
    return part.partition(".")[0].strip().casefold() in RESERVED_NAMES
