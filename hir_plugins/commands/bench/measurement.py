"""Wall-clock time, CPU time and additional memory of repeated calls."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from hir_core.run.machine import high_water_bytes
from hir_plugins.commands.bench.results.bench_result import Timing

REPEATS: Final = 5
MAX_REPEAT_SECONDS: Final = 20.0
"""A measurement is not repeated further once its calls have taken so long in all."""


def measure(
    function: Callable[[], object],
    repeats: int = REPEATS,
    warm_up: bool = True,
    max_repeat_s: float = MAX_REPEAT_SECONDS,
) -> Timing:
    """Calls `function` up to `repeats` times; with `warm_up`, once more before, so that compilers and caches are warm.

    There is one timed call at least, and no further one after `max_repeat_s` seconds.
    """
    gc.collect()
    before = reset_peak()
    if warm_up:
        function()
    wall, cpu = [], []
    started = time.perf_counter()
    for _ in range(max(1, repeats)):
        wall_start, cpu_start = time.perf_counter(), time.process_time()
        function()
        wall.append(time.perf_counter() - wall_start)
        cpu.append(time.process_time() - cpu_start)
        if time.perf_counter() - started > max_repeat_s:
            break
    memory = added_memory(before)
    return Timing(min(wall), statistics.median(wall), max(wall), len(wall), min(cpu), memory)


class Stopwatch:
    """Measures one call that cannot be repeated, from the construction to `timing`."""

    def __init__(self, memory: bool = True) -> None:
        self._memory_before = reset_peak() if memory else None
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def timing(self) -> Timing:
        """The time since the construction, and the memory that was added at the peak."""
        seconds, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        return Timing(seconds, seconds, seconds, 1, cpu, added_memory(self._memory_before))


def added_memory(before: int | None) -> int | None:
    """Bytes by which the peak exceeds an earlier size; None if the system does not report them."""
    peak = None if before is None else high_water_bytes()
    return None if before is None or peak is None else max(0, peak - before)


def reset_peak() -> int | None:
    """Resets the peak of the process's memory; returns its present size in bytes, or None if the system is not Linux.

    Memory that the allocator keeps is released first if possible; otherwise a second call would seem to need none.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)  # only glibc has it
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return high_water_bytes()
