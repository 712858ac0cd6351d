"""Suppresses what a native library prints by itself, where its errors are reported as exceptions of ours."""

from __future__ import annotations

import contextlib
import io
import os
import threading
from collections.abc import Iterator
from typing import Final

_FILE_DESCRIPTORS: Final = (1, 2)
"""Standard output and standard error."""

_LOCK: Final = threading.Lock()


@contextlib.contextmanager
def suppress_native_output() -> Iterator[None]:
    """Redirects standard output and error of the whole process, other threads included, to nowhere: for short calls.

    `sys.stdout` is redirected as well, because bindings also print through Python. A descriptor that the process does
    not have is left alone.
    """
    with _LOCK, contextlib.ExitStack() as cleanup, contextlib.redirect_stdout(io.StringIO()):
        with contextlib.suppress(OSError):
            null_device = os.open(os.devnull, os.O_WRONLY)
            cleanup.callback(os.close, null_device)
            for descriptor in _FILE_DESCRIPTORS:
                original = os.dup(descriptor)
                cleanup.callback(os.close, original)
                cleanup.callback(os.dup2, original, descriptor)
                os.dup2(null_device, descriptor)
        yield
