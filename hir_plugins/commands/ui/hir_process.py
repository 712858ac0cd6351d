"""A `hir` command in a process of its own, with the last lines that it printed."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Final

KEPT_LINES: Final = 50
MAX_LINE: Final = 4000
"""Longer lines are cut: memory stays bounded whatever a command prints."""

ERROR_PREFIX: Final = "hir: "
"""How the last line of a failed command begins."""


class HirProcess:
    """`hir ARGUMENTS`; its output goes to the file `output`, what it prints on stderr is kept in part."""

    def __init__(self, arguments: Sequence[str], output: Path) -> None:
        # -P: no module is imported from the current folder, which may be one of photographs
        command = [sys.executable, "-P", "-m", "hir_core.cli", *arguments]
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._stopped = False
        with open(output, "wb") as target:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=target,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C in the terminal reaches the server alone, which stops its processes
                text=True,
                encoding="utf-8",
                errors="replace",
                env=os.environ | {"PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1"},
            )
        self._reader = threading.Thread(target=self._read, name="hir-ui-output", daemon=True)
        self._reader.start()

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    @property
    def has_failed(self) -> bool:
        """Whether it ended by itself with an error."""
        return not self.is_running and self._process.returncode != 0 and not self._stopped

    @property
    def was_stopped(self) -> bool:
        """Whether it ended because `stop` was called."""
        return not self.is_running and self._stopped and self._process.returncode != 0

    @property
    def sentence(self) -> str:
        """Why the command failed: its own error message, or its last line."""
        self._reader.join(2)
        lines = [line for line in self._lines if line.strip()]
        errors = [line.removeprefix(ERROR_PREFIX) for line in lines if line.startswith(ERROR_PREFIX)]
        if errors:
            return errors[-1]
        code = self._process.returncode
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"the process was ended by the system ({signal.Signals(-code).name}); it may need more memory"
        return lines[-1] if lines else f"the process ended with exit code {code}"

    def stop(self) -> None:
        """Interrupts the command, as Ctrl-C does; what it has computed stays."""
        if self.is_running:
            self._stopped = True
            # a program that ignores SIGINT, as one in the background of a script does, has children that ignore it
            if os.name == "posix" and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
                self._process.send_signal(signal.SIGINT)
            else:
                self._process.terminate()

    def end(self, seconds: float) -> None:
        """Stops it, and ends it if it still runs after that time."""
        self.stop()
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as stream:
            while line := stream.readline(MAX_LINE):
                self._lines.append(line.rstrip())
