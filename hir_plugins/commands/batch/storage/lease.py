"""A lease on a destination, so that only one batch at a time writes there: a small file that the driver renews."""

from __future__ import annotations

import json
import os
import platform
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

from hir_core.errors import HirError, InputError
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.layout import json_bytes
from hir_plugins.commands.batch.storage.storage_path import StoragePath

EXPIRY_SECONDS: Final = 60.0
"""A lease that was not renewed for so long belongs to a batch that ended without releasing it."""


@dataclass(frozen=True)
class LeaseTiming:
    """How often a lease is renewed, and how a batch waits for another batch's lease."""

    renewal_seconds: float = 10.0
    sleep: Callable[[float], None] = time.sleep


class Lease:
    """A context manager that acquires the lease, renews it in a thread, and releases it."""

    def __init__(
        self, path: StoragePath, on_message: Callable[[str], None], timing: LeaseTiming = LeaseTiming()
    ) -> None:
        self.token = secrets.token_hex(8)
        self.lost = False
        """Whether another batch acquired the lease, which it may once this one has expired."""
        self._path, self._on_message, self._timing = path, on_message, timing
        self._released = threading.Event()
        self._renewal = threading.Thread(target=self._renew, name="hir-batch-lease", daemon=True)

    def __enter__(self) -> Self:
        last_renewal: object = None
        while not object_store.create(self._path, self._document()):
            other = read_lease(self._path)
            host = other.get("host")
            if other and not is_expired(other, time.time()):
                renewed = other.get("renewed")
                if host == platform.node() or last_renewal not in (None, renewed):
                    raise InputError(
                        f"another batch is writing to {self._path.url.rpartition('/.batch/')[0]} (process "
                        f"{other.get('pid')} on {host}); wait until it ends"
                    )
                if last_renewal is None:
                    self._on_message(
                        f"a batch on {host} holds the destination; waiting up to {EXPIRY_SECONDS:.0f} s to see "
                        "whether it is still running"
                    )
                last_renewal = renewed
                self._timing.sleep(self._timing.renewal_seconds / 2)
                continue
            if other:
                self._on_message(f"continuing a batch that ended on {host} before it was finished")
            object_store.write(self._path, self._document())
            if lease_owner(self._path) == self.token:
                break
        self._renewal.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._released.set()
        self._renewal.join()
        if lease_owner(self._path) == self.token:
            object_store.remove(self._path)

    def _renew(self) -> None:
        while not self._released.wait(self._timing.renewal_seconds):
            try:
                self.lost = lease_owner(self._path) not in (self.token, "")
                if not self.lost:
                    object_store.write(self._path, self._document())
            except HirError as error:  # revoked permissions too: an exception would end this thread silently
                self._on_message(f"the lease was not renewed: {error}")

    def _document(self) -> bytes:
        return json_bytes({"owner": self.token, "host": platform.node(), "pid": os.getpid(), "renewed": time.time()})


def read_lease(path: StoragePath) -> dict[str, Any]:
    """The document of a lease; empty if there is none or if it is not a JSON object."""
    try:
        lease = json.loads(object_store.read(path) or b"{}")
    except (ValueError, RecursionError):
        return {}
    return lease if isinstance(lease, dict) else {}


def lease_owner(path: StoragePath) -> str:
    """The token of the batch that holds the lease; empty if no batch does."""
    return str(read_lease(path).get("owner", ""))


def is_expired(lease: Mapping[str, object], now: float) -> bool:
    """Whether the batch of a lease has ended: it was not renewed in time, or its process on this machine is gone.

    `now` is in seconds since the epoch.
    """
    renewed = lease.get("renewed")
    # Python's JSON reader accepts NaN, for which every comparison is false
    if not isinstance(renewed, int | float) or not now - renewed <= EXPIRY_SECONDS:
        return True
    pid = lease.get("pid")
    if os.name != "posix" or lease.get("host") != platform.node() or not isinstance(pid, int) or not 0 < pid < 1 << 31:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False
    return False
