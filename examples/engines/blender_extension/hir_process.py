"""A `hir` command in a process of its own. Nothing here needs Blender."""

import atexit
import json
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path

ERROR_PREFIX = "hir: "
"""How the line of an error begins."""

KEPT_BYTES = 20_000
"""So much of the end of what a command prints is read."""


class HirError(Exception):
    """One sentence for the user."""


def find_program(program):
    """The path of the program; raises `HirError` where there is none."""
    found = shutil.which(os.path.expanduser(program or "hir"))
    if found is None:
        raise HirError(f"the program {program!r} was not found: set its path in the preferences of the add-on hir")
    return found


class HirProcess:
    """`PROGRAM ARGUMENTS`, started at once. `run` is the folder whose progress.json is read."""

    def __init__(self, program, arguments, run):
        self._run = Path(run)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - `end` closes it
        self._stopped = False
        try:
            self._process = subprocess.Popen(
                [find_program(program), *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                env=os.environ | {"PYTHONUTF8": "1"},
                # a window of its own would open on Windows
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except HirError:
            self._errors.close()
            raise
        except OSError as error:
            self._errors.close()
            raise HirError(f"{program} could not be started: {error.strerror or error}") from error
        atexit.register(self.end)  # Blender was closed

    @property
    def is_running(self):
        return self._process.poll() is None

    @property
    def was_stopped(self):
        """Whether it ended because `stop` was called."""
        return self._stopped and not self.is_running and self._process.returncode != 0

    @property
    def has_succeeded(self):
        return self._process.poll() == 0

    def progress(self):
        """One line about the stage that is computed, from progress.json."""
        try:
            state = json.loads((self._run / "progress.json").read_text(encoding="utf-8"))
            text = f"{state['stage']}: {state['step']} of {state['steps']}"
            minutes = float(state["seconds_left"]) / 60
        except (OSError, ValueError, KeyError, TypeError):
            return "hir is starting"  # the file is written when the first stage begins
        if minutes > 0:
            text += f", {minutes:.0f} min left" if minutes >= 1 else ", less than a minute left"
        return text

    def sentence(self):
        """Why the command failed: its own error message, or its last line."""
        self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(self._errors.tell() - KEPT_BYTES, 0))
        lines = [line.strip() for line in self._errors.read().decode("utf-8", "replace").splitlines() if line.strip()]
        errors = [line.removeprefix(ERROR_PREFIX) for line in lines if line.startswith(ERROR_PREFIX)]
        if errors:
            return errors[-1]
        code = self._process.returncode
        if code is not None and code < 0:
            return f"hir was ended by the system (signal {-code}); it may need more memory"
        return lines[-1] if lines else f"hir ended with exit code {code}"

    def wait(self):
        """Returns when the process has ended."""
        self._process.wait()

    def stop(self):
        """Interrupts the command, as Ctrl-C does; finished stages stay."""
        if self.is_running:
            self._stopped = True
            # a program that ignores SIGINT, as one in the background of a script does, has children that ignore it
            if os.name == "posix" and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
                self._process.send_signal(signal.SIGINT)
            else:
                self._process.terminate()

    def end(self, seconds=5):
        """Stops the process, ends it if it still runs after that time, and closes what it printed."""
        self.stop()
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._errors.close()
        atexit.unregister(self.end)
