"""Time and memory of a process."""

from __future__ import annotations

import subprocess
import sys

import pytest

LARGE = 600 << 20


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not pass on a peak")
def test_the_peak_of_a_process_is_its_own() -> None:
    """Not that of the process that started it, which `getrusage` reports."""
    child = "from hir_core.run.machine import peak_memory_bytes; print(peak_memory_bytes())"
    parent = (
        "import resource, subprocess, sys\n"
        f"held = b'x' * {LARGE}\n"
        f"found = subprocess.run([sys.executable, '-c', {child!r}], capture_output=True, text=True, check=True)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, found.stdout)\n"
    )
    done = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=True)
    of_parent, of_child = map(int, done.stdout.split())
    assert 1 << 20 < of_child < LARGE < of_parent


def test_the_peak_counts_what_was_freed() -> None:
    code = (
        "from hir_core.run.machine import peak_memory_bytes\n"
        "before = peak_memory_bytes()\n"
        f"held = bytearray(b'x' * {LARGE}); del held\n"
        "print(peak_memory_bytes() - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) > LARGE // 2
