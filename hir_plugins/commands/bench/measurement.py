"""Seconds of repeated runs, and the memory that they add to the process."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import statistics
import time
from collections.abc import Callable
from pathlib import Path

from hir_plugins.commands.bench.results.bench_result import Timing

REPEATS = 5
PATIENCE_SECONDS = 20.0
"""A work that takes so long altogether is not repeated further, once there are two runs."""


def measure(
    work: Callable[[], object], repeats: int = REPEATS, warm_up: bool = True, patience: float = PATIENCE_SECONDS
) -> Timing:
    """Runs `work` again and again; compilers and caches are warm where `warm_up` is.

    One run is enough where it alone takes longer than `patience`, in seconds.
    """
    gc.collect()
    before = reset_peak()
    if warm_up:
        work()
    wall, cpu = [], []
    started = time.perf_counter()
    for _ in range(max(1, repeats)):
        wall_start, cpu_start = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - wall_start)
        cpu.append(time.process_time() - cpu_start)
        if time.perf_counter() - started > patience:
            break
    after = peak_bytes()
    memory = None if before is None or after is None else max(0, after - before)
    return Timing(min(wall), statistics.median(wall), max(wall), len(wall), min(cpu), memory)


def reset_peak() -> int | None:
    """Forgets the process's peak and returns its present size in bytes; None where the system cannot (not Linux).

    What the allocator keeps for later is given back first, where it can be: else a second run would take nothing.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)  # glibc alone has it
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return peak_bytes()


def peak_bytes() -> int | None:
    """Largest resident size since `reset_peak`; None where the system does not tell."""
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return None
