"""The session of `make lower-bounds` starts: it has the base install alone, so no torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_what_every_test_session_loads_needs_no_torch() -> None:
    script = (
        "import importlib, sys; sys.modules['torch'] = None\n"
        "conftest = importlib.import_module('tests.conftest')\n"
        "for name in conftest.pytest_plugins: importlib.import_module(name)"
    )
    path = [str(ROOT), str(ROOT / "tools"), str(ROOT / "exporters")]
    command = [sys.executable, "-c", f"import sys; sys.path[:0] = {path}\n{script}"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
