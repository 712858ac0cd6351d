"""A worker's place on its node's disk for one capture: the staged photographs and the run as far as it is."""

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
from hir_plugins.commands.batch.storage.content_hash import content_mark
from hir_plugins.commands.batch.storage.object_store import Place

KEEP_SECONDS: Final = 6 * 3600.0
"""A desk that nobody came back to for so long is cleared; a tenth of an hour when the disk is nearly full."""

FULL: Final = 0.9
LOCK_SECONDS: Final = 60.0
"""How long a worker waits for one that was given up and may still be ending."""


def default_cache() -> Path:
    """Below the folder for temporary files: what lies there can always be fetched or made again."""
    owner = os.getuid() if hasattr(os, "getuid") else os.getlogin()
    cache = Path(tempfile.gettempdir()) / f"hir-batch-{owner}"
    cache.mkdir(exist_ok=True, mode=0o700)
    if hasattr(os, "getuid") and cache.stat().st_uid != os.getuid():  # everybody may write beside it
        raise InputError(f"{cache} belongs to another user; name a folder of your own with --cache")
    return cache


@dataclass(frozen=True)
class Desk:
    """A folder that one worker at a time uses; the next one on this node finds what it left."""

    folder: Path

    @property
    def run(self) -> Path:
        return self.folder / "run"

    def stage(self, source: Place, content: str) -> tuple[Path, str]:
        """The capture as a local path and the mark of its bytes; `content` is that mark where it is known.

        A capture on this machine's own filesystem is used where it lies.
        """
        if source.local is not None:
            if not source.local.exists():
                raise CaptureError(f"{source} does not exist on this node; give the folder of a capture")
            return source.local, content or content_mark(source.local)
        staged = self.folder / "capture" / (content or "unknown") / source.name
        if content and staged.exists():
            return staged, content
        listed = object_store.files(source)
        if not listed:
            raise CaptureError(f"{source} does not exist or is empty; give the folder of a capture")
        shutil.rmtree(self.folder / "capture", ignore_errors=True)
        arriving = self.folder / "capture" / f"arriving-{secrets.token_hex(4)}"
        object_store.download(source, listed, arriving / source.name)
        mark = content_mark(arriving / source.name)
        os.replace(arriving, self.folder / "capture" / mark)
        return self.folder / "capture" / mark / source.name, mark

    def begin(self, mark: str) -> None:
        """Keeps the run of the same input and settings, clears any other."""
        noted = self.folder / "mark"
        if not noted.exists() or noted.read_text(encoding="utf-8") != mark:
            shutil.rmtree(self.run, ignore_errors=True)
            noted.write_text(mark, encoding="utf-8")

    def clear(self) -> None:
        """The chain ended: nothing of it is needed here."""
        for entry in ("capture", "run"):
            shutil.rmtree(self.folder / entry, ignore_errors=True)
        (self.folder / "mark").unlink(missing_ok=True)


@contextlib.contextmanager
def desk(cache: Path, destination: str, name: str) -> Iterator[Desk]:
    """The desk of one capture of one batch, locked; old ones of others are cleared on the way."""
    mark = hashlib.blake2b(f"{destination}\n{name}".encode(), digest_size=12).hexdigest()
    cache.mkdir(parents=True, exist_ok=True, mode=0o700)
    sweep(cache, time.time())
    folder = cache / mark
    folder.mkdir(exist_ok=True)
    lock = FileLock(folder / "lock", timeout=LOCK_SECONDS)
    try:
        lock.acquire(poll_interval=0.2)
    except Timeout:
        raise StoreError(f"another worker of this node still works on {name}") from None
    try:
        os.utime(folder)
        yield Desk(folder)
        os.utime(folder)
    finally:
        lock.release()


def sweep(cache: Path, now: float) -> None:
    """Clears desks that are old and that nobody uses."""
    usage = shutil.disk_usage(cache)
    keep = KEEP_SECONDS if usage.used < FULL * usage.total else KEEP_SECONDS / 60
    for folder in cache.iterdir():
        with contextlib.suppress(OSError):  # another worker was faster
            if now - folder.stat().st_mtime > keep:
                with FileLock(folder / "lock").acquire(blocking=False):  # Timeout, an OSError, while in use
                    shutil.rmtree(folder)
