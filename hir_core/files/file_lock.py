"""An advisory lock on an open file, which ends with the process, however it ends."""

from __future__ import annotations

import os
from typing import IO


def try_lock(stream: IO[bytes]) -> bool:
    """Takes the lock; False where another process has it."""
    try:
        if os.name == "posix":
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            stream.seek(0)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    except OSError:
        return False
    return True
