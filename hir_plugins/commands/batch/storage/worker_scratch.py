"""The folder on a node's disk in which a worker keeps the staged capture and the run of one capture."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from hir_core.errors import CaptureError, InputError
from hir_plugins.commands.batch.retries import StoreError
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import content_hash
from hir_plugins.commands.batch.storage.storage_path import StoragePath

MAX_AGE_SECONDS: Final = 6 * 3600.0
"""A scratch folder that was not used for so long is removed."""

MAX_AGE_ON_FULL_DISK_SECONDS: Final = 360.0
FULL_DISK_FRACTION: Final = 0.9

LOCK_TIMEOUT_SECONDS: Final = 60.0
"""How long a worker waits for a cancelled worker that may still be ending."""


def default_cache() -> Path:
    """A folder of this user among the temporary files; its content can always be fetched or computed again."""
    owner = os.getuid() if hasattr(os, "getuid") else os.getlogin()
    cache = Path(tempfile.gettempdir()) / f"hir-batch-{owner}"
    cache.mkdir(exist_ok=True, mode=0o700)
    if hasattr(os, "getuid") and cache.stat().st_uid != os.getuid():  # every user may write in the parent folder
        raise InputError(f"{cache} belongs to another user; give a folder of your own with --cache")
    return cache


@dataclass(frozen=True)
class WorkerScratch:
    """A folder that one worker at a time uses; the next worker on this node reuses its content."""

    folder: Path

    @property
    def run(self) -> Path:
        return self.folder / "run"

    def stage_capture(self, source: StoragePath, content: str) -> tuple[Path, str]:
        """The capture as a local path, and its content hash; `content` is that hash if it is known, otherwise empty.

        A capture on this machine's file system is used without a copy.
        """
        if source.local is not None:
            if not source.local.exists():
                raise CaptureError(f"{source} does not exist on this node; give the folder of a capture")
            return source.local, content or content_hash(source.local)
        staged = self.folder / "capture" / (content or "unknown") / source.name
        if content and staged.exists():
            return staged, content
        listing = object_store.list_files(source)
        if not listing:
            raise CaptureError(f"{source} does not exist or is empty; give the folder of a capture")
        shutil.rmtree(self.folder / "capture", ignore_errors=True)
        partial = self.folder / "capture" / f"partial-{secrets.token_hex(4)}"
        object_store.download(source, listing, partial / source.name)
        content = content_hash(partial / source.name)
        os.replace(partial, self.folder / "capture" / content)
        return self.folder / "capture" / content / source.name, content

    def prepare_run(self, key: str) -> None:
        """Keeps a run with the same `result_key` and removes any other."""
        noted = self.folder / "result_key"
        if not noted.exists() or noted.read_text(encoding="utf-8") != key:
            shutil.rmtree(self.run, ignore_errors=True)
            noted.write_text(key, encoding="utf-8")

    def clear(self) -> None:
        """Removes everything: the capture is finished."""
        for entry in ("capture", "run"):
            shutil.rmtree(self.folder / entry, ignore_errors=True)
        (self.folder / "result_key").unlink(missing_ok=True)


@contextlib.contextmanager
def worker_scratch(
    cache: Path, destination: str, name: str, lock_timeout_s: float = LOCK_TIMEOUT_SECONDS
) -> Iterator[WorkerScratch]:
    """The locked scratch folder of one capture of one batch; stale folders in the cache are removed.

    Raises `StoreError` if another worker of this node holds the lock for longer than `lock_timeout_s`.
    """
    identifier = hashlib.blake2b(f"{destination}\n{name}".encode(), digest_size=12).hexdigest()
    cache.mkdir(parents=True, exist_ok=True, mode=0o700)
    remove_stale_scratch(cache, time.time())
    folder = cache / identifier
    folder.mkdir(exist_ok=True)
    lock = FileLock(folder / "lock", timeout=lock_timeout_s, poll_interval=0.2)
    try:
        lock.acquire()
    except Timeout:
        raise StoreError(f"another worker of this node is still processing {name}") from None
    try:
        os.utime(folder)
        yield WorkerScratch(folder)
        os.utime(folder)
    finally:
        lock.release()


def remove_stale_scratch(cache: Path, now: float) -> None:
    """Removes scratch folders that are old and that no worker uses; `now` is in seconds since the epoch."""
    usage = shutil.disk_usage(cache)
    full = usage.used >= FULL_DISK_FRACTION * usage.total
    max_age_s = MAX_AGE_ON_FULL_DISK_SECONDS if full else MAX_AGE_SECONDS
    for folder in cache.iterdir():
        with contextlib.suppress(OSError, Timeout):  # in use, or removed by another worker meanwhile
            if now - folder.stat().st_mtime > max_age_s:
                with FileLock(folder / "lock", timeout=0):
                    shutil.rmtree(folder)
