"""Keeps what a native library prints by itself off the screen, where its errors are told in words of ours."""

from __future__ import annotations

import contextlib
import io
import os
import threading
from collections.abc import Iterator
from typing import Final

_STREAMS: Final = (1, 2)
_LOCK: Final = threading.Lock()


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Standard output and error of the process lead nowhere meanwhile, those of other threads, too: for short calls.

    Bindings print through Python, too. A stream that the process does not have is left as it is.
    """
    with _LOCK, contextlib.ExitStack() as restored, contextlib.redirect_stdout(io.StringIO()):
        with contextlib.suppress(OSError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            restored.callback(os.close, nowhere)
            for stream in _STREAMS:
                kept = os.dup(stream)
                restored.callback(os.close, kept)
                restored.callback(os.dup2, kept, stream)
                os.dup2(nowhere, stream)
        yield
