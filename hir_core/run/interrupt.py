"""Ctrl-C that cannot get lost and never waits for long.

Python raises `KeyboardInterrupt` wherever it happens to be: in a finaliser, a callback of native code, or a library's
import that catches everything, it is swallowed and the run would go on. Here it is remembered, and raised again where
the stage next reports its progress. While native code computes, Python raises nothing at all: a thread waits for the
signal beside it and ends the process when it is still there after `PATIENCE_SECONDS`. What is on disk is whole at any
moment, so nothing is lost.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from types import FrameType

PATIENCE_SECONDS = 1.5
"""Longest time between Ctrl-C and the end of the process."""

_asked = threading.Event()


def remember_interrupts(leave: Callable[[], None] | None = None) -> None:
    """From here on Ctrl-C is remembered until it ends the process; only a process of our own should call this.

    `leave` is called, in a thread, when the process is still there after `PATIENCE_SECONDS`; it should end it.
    """

    def interrupted(number: int, frame: FrameType | None) -> None:
        _asked.set()
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, interrupted)
    if leave is not None and os.name == "posix":
        _watch(leave)


def raise_lost_interrupt() -> None:
    """Raises `KeyboardInterrupt` if one came and did not end the process."""
    if _asked.is_set():
        _asked.clear()
        raise KeyboardInterrupt


def _watch(leave: Callable[[], None]) -> None:
    """The system writes the number of every signal into one end of a pair; a thread reads the other."""
    heard, told = socket.socketpair()
    told.setblocking(False)
    signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)

    def wait() -> None:
        with told:  # kept open for as long as the thread lives
            while number := heard.recv(1):
                if number[0] == signal.SIGINT:
                    time.sleep(PATIENCE_SECONDS)
                    leave()

    threading.Thread(target=wait, name="hir-interrupt", daemon=True).start()
