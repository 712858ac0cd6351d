"""Files on any filesystem that fsspec knows, asked with patience and written complete or not at all."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from hir_core.errors import InputError, MissingExtraError
from hir_plugins.commands.batch.retries import StoreError, Value, ask, one_line

AT_ONCE: Final = 16
"""Files that are carried at the same time."""

WHOLE_WRITES: Final = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oci", "memory"})
"""Protocols on which an object appears when its last byte arrived, or not at all."""


@dataclass(frozen=True)
class Stamp:
    """What a listing says of a file without reading it."""

    size: int
    mark: str
    """The store's checksum or version where it gives one, else the time of the last change."""


@dataclass(frozen=True)
class Place:
    """A file or a folder: a path of this machine or a URL such as `s3://bucket/folder`."""

    url: str

    def __truediv__(self, name: str) -> Place:
        return Place(f"{self.url.rstrip('/')}/{name}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        """The last part of the address."""
        return self.url.rstrip("/").rpartition("/")[2]

    @property
    def local(self) -> Path | None:
        """The path, where the place is on this machine's own filesystem."""
        protocol, separator, rest = self.url.partition("://")
        if not separator:
            return Path(self.url)
        return Path(rest) if protocol in ("file", "local") else None

    def opened(self) -> tuple[Any, str]:
        """fsspec's filesystem and the path in it; one sentence where its package is missing or the URL is none."""
        try:
            import fsspec
        except ImportError:
            raise MissingExtraError("hir batch needs fsspec; install it with: pip install 'hir[batch]'") from None
        try:
            filesystem, path = fsspec.url_to_fs(self.url)
        except ImportError as error:
            protocol = self.url.partition("://")[0]
            extra = {"s3": "batch-s3", "s3a": "batch-s3", "gs": "batch-gs", "gcs": "batch-gs"}.get(protocol)
            advice = f"; install it with: pip install 'hir[{extra}]'" if extra else f" ({error})"
            raise MissingExtraError(f"{self.url} needs another package{advice}") from None
        except ValueError as error:
            raise InputError(f"{self.url} cannot be opened: {error}") from None
        return filesystem, path


def place(text: str) -> Place:
    """A place from what a user wrote; a local path becomes absolute."""
    return Place(text.rstrip("/")) if "://" in text else Place(str(Path(text).expanduser().resolve()))


def files(at: Place) -> dict[str, Stamp]:
    """Every file below a folder by its relative name, sorted; for a file one entry named ""; empty where nothing is."""
    filesystem, path = at.opened()

    def listed() -> dict[str, Stamp]:
        filesystem.invalidate_cache()
        found = filesystem.find(path, detail=True)
        root = filesystem._strip_protocol(path).rstrip("/")
        return {name[len(root) :].lstrip("/"): _stamp(info) for name, info in sorted(found.items())}

    with contextlib.suppress(FileNotFoundError):
        return ask(listed, f"{at} cannot be listed")
    return {}


def read(at: Place) -> bytes | None:
    """The bytes of a file, None where there is none."""
    filesystem, path = at.opened()
    try:
        return bytes(ask(lambda: filesystem.cat_file(path), f"{at} cannot be read"))
    except FileNotFoundError:
        return None


def exists(at: Place) -> bool:
    """Whether there is a file or a folder."""
    filesystem, path = at.opened()

    def found() -> bool:
        filesystem.invalidate_cache()
        try:
            filesystem.info(path)
        except FileNotFoundError:
            return False
        return True

    return ask(found, f"{at} cannot be looked at")


def write(at: Place, content: bytes) -> None:
    """Makes a file hold exactly `content`; a reader sees the old one or the new one."""
    from hir_exporters.files.atomic import write_bytes_atomic

    filesystem, path = at.opened()
    if at.local is not None:
        write_bytes_atomic(at.local, content)
        return

    def written() -> None:
        if at.url.partition("://")[0] in WHOLE_WRITES:
            filesystem.pipe_file(path, content)
            return
        temporary = f"{path}.{secrets.token_hex(8)}"
        filesystem.makedirs(path.rpartition("/")[0], exist_ok=True)
        filesystem.pipe_file(temporary, content)
        filesystem.mv(temporary, path)

    _put(written, f"{at} cannot be written")


def create(at: Place, content: bytes) -> bool:
    """Makes a file that was not there; False where one is. Stores without conditional writes decide by a look first."""
    filesystem, path = at.opened()

    def created() -> bool:
        try:
            if at.local is None:
                filesystem.pipe_file(path, content, mode="create")
            else:
                at.local.parent.mkdir(parents=True, exist_ok=True)
                with at.local.open("xb") as stream:
                    stream.write(content)
        except FileExistsError:
            return False
        return True

    return _put(created, f"{at} cannot be made")


def remove(at: Place) -> None:
    """Removes a file or a folder with all that is in it; one that is not there is fine."""
    filesystem, path = at.opened()

    def removed() -> None:
        filesystem.invalidate_cache()
        with contextlib.suppress(FileNotFoundError):
            filesystem.rm(path, recursive=True)

    ask(removed, f"{at} cannot be removed")


def download(at: Place, listed: Mapping[str, Stamp], folder: Path) -> None:
    """Brings the files of a listing below `folder`, or the one file of that place to it; checks their sizes."""
    filesystem, path = at.opened()

    def one(name: str) -> None:
        target = folder / name if name else folder
        target.parent.mkdir(parents=True, exist_ok=True)
        source = f"{path}/{name}" if name else path

        def fetched() -> None:
            filesystem.get_file(source, str(target))
            if target.stat().st_size != listed[name].size:
                raise OSError(f"{target.stat().st_size} of {listed[name].size} bytes arrived")

        try:
            ask(fetched, f"{at / name if name else at} cannot be read")
        except FileNotFoundError:
            raise StoreError(f"{at / name if name else at} is gone while its capture is read") from None

    _at_once(one, list(listed))


def upload(sources: Mapping[str, Path], at: Place) -> None:
    """Writes local files below a folder of a store, by relative name."""
    filesystem, path = at.opened()
    if at.url.partition("://")[0] not in WHOLE_WRITES:  # object stores have no folders
        for folder in sorted({f"{path}/{name}".rpartition("/")[0] for name in sources}):
            _put(partial(filesystem.makedirs, folder, exist_ok=True), f"{folder} cannot be made")

    def one(name: str) -> None:
        _put(lambda: filesystem.put_file(str(sources[name]), f"{path}/{name}"), f"{at / name} cannot be written")

    _at_once(one, list(sources))


def _put(call: Callable[[], Value], what: str) -> Value:
    """`ask` where there is something to write: what is not there is the bucket."""
    try:
        return ask(call, what)
    except FileNotFoundError as error:
        raise InputError(f"{what}: {one_line(error)}; is there such a bucket or disk?") from error


def _at_once(one: Callable[[str], None], names: Sequence[str]) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for done in [pool.submit(one, name) for name in names]:
            done.result()


def _stamp(info: Mapping[str, Any]) -> Stamp:
    """From what a filesystem lists; local files by nanoseconds, objects by checksum."""
    for key in ("ETag", "etag", "md5Hash", "content_md5", "version_id", "generation"):
        if info.get(key):
            return Stamp(int(info["size"]), str(info[key]).strip('"'))
    for key in ("mtime", "LastModified", "last_modified", "updated", "created"):
        if info.get(key):
            return Stamp(int(info["size"]), repr(info[key]))
    return Stamp(int(info.get("size") or 0), "")
