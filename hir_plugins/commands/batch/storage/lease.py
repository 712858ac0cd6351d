"""One batch at a time works on a destination: a small file that its driver renews."""

from __future__ import annotations

import json
import os
import platform
import secrets
import threading
import time
from collections.abc import Callable
from typing import Any, Final, Self

from hir_core.errors import HirError, InputError
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.layout import json_bytes
from hir_plugins.commands.batch.storage.object_store import Place

RENEW_SECONDS: Final = 10.0
STALE_SECONDS: Final = 60.0
"""A lease that was not renewed for so long belongs to a batch that died."""


class Lease:
    """A context manager: takes the lease, renews it in the background, gives it back."""

    def __init__(self, at: Place, say: Callable[[str], None]) -> None:
        self.token = secrets.token_hex(8)
        self.lost = False
        """Whether another batch took the destination, as it may after a long silence."""
        self._at, self._say = at, say
        self._ended = threading.Event()
        self._renewing = threading.Thread(target=self._renew, name="hir-batch-lease", daemon=True)

    def __enter__(self) -> Self:
        seen: Any = None
        while not object_store.create(self._at, self._document()):
            other = read_lease(self._at)
            if other and not died(other, time.time()):
                if other.get("host") == platform.node() or seen not in (None, other.get("renewed")):
                    raise InputError(
                        f"another batch works on {self._at.url.rpartition('/.batch/')[0]} (process "
                        f"{other.get('pid')} on {other.get('host')}); wait for it to end"
                    )
                if seen is None:
                    self._say(
                        f"the destination belongs to a batch on {other.get('host')}; waiting up to "
                        f"{STALE_SECONDS:.0f} s for a sign of life"
                    )
                seen = other.get("renewed")
                time.sleep(RENEW_SECONDS / 2)
                continue
            if other:
                self._say(f"going on with a batch that ended on {other.get('host')} before it was finished")
            object_store.write(self._at, self._document())
            if owner_of(self._at) == self.token:
                break
        self._renewing.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._renewing.join()
        if owner_of(self._at) == self.token:
            object_store.remove(self._at)

    def _renew(self) -> None:
        while not self._ended.wait(RENEW_SECONDS):
            try:
                self.lost = owner_of(self._at) not in (self.token, "")
                if not self.lost:
                    object_store.write(self._at, self._document())
            except HirError as error:  # rights that were taken away, too: a thread that died would say nothing
                self._say(f"the lease was not renewed: {error}")

    def _document(self) -> bytes:
        return json_bytes({"owner": self.token, "host": platform.node(), "pid": os.getpid(), "renewed": time.time()})


def read_lease(at: Place) -> dict[str, Any]:
    """The lease as it is; empty where there is none or it is no JSON object."""
    try:
        found = json.loads(object_store.read(at) or b"{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def owner_of(at: Place) -> str:
    """The token of the batch that has the lease, empty where nobody has it."""
    return str(read_lease(at).get("owner", ""))


def died(lease: dict[str, Any], now: float) -> bool:
    """Whether the batch of a lease ended: it is silent, or it ran on this machine and its process is gone."""
    renewed = lease.get("renewed")
    # NaN, which Python's JSON reads, is no time
    if not isinstance(renewed, int | float) or not now - renewed <= STALE_SECONDS:
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
