"""The command line of this checkout, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path


def hir(*words: str | Path) -> float:
    """Runs a command and returns its seconds; `CalledProcessError` where it fails."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "hir_core.cli", *words], check=True)
    return time.perf_counter() - began
