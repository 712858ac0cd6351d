"""Ctrl-C that cannot get lost.

Python raises `KeyboardInterrupt` wherever it happens to be: in a finaliser, a callback of native code, or a library's
import that catches everything, it is swallowed and the run would go on. Here it is remembered, and raised again where
the stage next reports its progress.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType

_asked = threading.Event()


def remember_interrupts() -> None:
    """From here on Ctrl-C is remembered until it ends the process; only a process of our own should call this."""

    def interrupted(number: int, frame: FrameType | None) -> None:
        _asked.set()
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, interrupted)


def raise_lost_interrupt() -> None:
    """Raises `KeyboardInterrupt` if one came and did not end the process."""
    if _asked.is_set():
        _asked.clear()
        raise KeyboardInterrupt
