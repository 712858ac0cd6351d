"""Reliable handling of Ctrl-C.

Python raises `KeyboardInterrupt` at an arbitrary place. In a finaliser, a callback of native code, or an import that
catches everything, the exception is lost and the run would continue. This module remembers the signal and raises the
exception again when the stage reports progress next. During an import it raises nothing at first, because native code
that is being initialised may abort. While native code computes, Python raises nothing: a thread waits for the signal
and ends the process if it still runs after `MAX_EXIT_SECONDS`. Files on disk are complete at any moment: nothing is
lost.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from types import FrameType

MAX_EXIT_SECONDS = 1.5
"""Longest time between Ctrl-C and the end of the process."""

_interrupted = threading.Event()


def remember_interrupts(leave: Callable[[], None] | None = None) -> None:
    """Installs the signal handler; only for processes that `hir` owns.

    `leave` is called in a thread if the process still runs `MAX_EXIT_SECONDS` after the signal; it should end it.
    """

    watched = leave is not None and os.name == "posix"

    def interrupted(number: int, frame: FrameType | None) -> None:
        _interrupted.set()
        # what is not raised here is raised at the next report of progress, or the thread that watches ends the process
        if not (watched and _is_importing(frame)):
            signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, interrupted)
    if leave is not None and watched:
        _watch(leave)


def _is_importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported: an exception in the initialisation of native code may abort the process."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def raise_lost_interrupt() -> None:
    """Raises `KeyboardInterrupt` if a signal arrived and did not end the process."""
    if _interrupted.is_set():
        _interrupted.clear()
        raise KeyboardInterrupt


def was_interrupted() -> bool:
    """Whether a signal arrived: an exception may then be what a library made of the interrupt, as in an import."""
    return _interrupted.is_set()


def _watch(leave: Callable[[], None]) -> None:
    """Python writes the number of every signal into one end of a socket pair; a thread reads the other end."""
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)

    def wait() -> None:
        with sender:  # stays open while the thread runs
            while number := receiver.recv(1):
                if number[0] == signal.SIGINT:
                    time.sleep(MAX_EXIT_SECONDS)
                    leave()

    threading.Thread(target=wait, name="hir-interrupt", daemon=True).start()
