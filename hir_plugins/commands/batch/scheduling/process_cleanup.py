"""Ends the processes of a Ray cluster whose driver was killed: Ray's own agents outlive it by up to minutes.

A helper process waits for the end of its standard input, which is that of the driver, however it ends. It then kills
every process that inherited a mark in its environment. Linux only: elsewhere there is no /proc, and none is found.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Final

VARIABLE: Final = "HIR_BATCH_CLUSTER"
"""Environment variable that marks all processes of one cluster."""
GRACE_SECONDS: Final = 3.0
"""Time for processes to end by themselves."""


@contextlib.contextmanager
def processes_end_with_this_one() -> Iterator[None]:
    """Processes that are started in the block end soon after it, or after this process if it is killed."""
    mark = uuid.uuid4().hex
    helper = subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, mark],  # -P: the current folder may be one of a stranger's files
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches the driver alone
    )
    os.environ[VARIABLE] = mark
    try:
        yield
    finally:
        del os.environ[VARIABLE]
        assert helper.stdin is not None
        helper.stdin.close()
        helper.wait()


def marked_processes(mark: str) -> list[int]:
    """Ids of running processes whose initial environment has the mark; without this one."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
            entries = (folder / "environ").read_bytes().split(b"\0")
            if state != "Z" and f"{VARIABLE}={mark}".encode() in entries and int(folder.name) != os.getpid():
                found.append(int(folder.name))
    return found


def main(mark: str) -> None:
    """Waits for the end of standard input, then for `GRACE_SECONDS` at most, then kills what is left."""
    sys.stdin.buffer.read()
    deadline = time.monotonic() + GRACE_SECONDS
    while marked_processes(mark) and time.monotonic() < deadline:
        time.sleep(0.1)
    while left := marked_processes(mark):
        for process in left:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        time.sleep(0.1)
        if time.monotonic() > deadline + GRACE_SECONDS:
            return


if __name__ == "__main__":
    main(sys.argv[1])
