"""Independent jobs on several threads, each with an equal share of torch's threads.

Operations of torch on small tensors hardly gain from a second thread. Two of them side by side do.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")


class JobStoppedError(Exception):
    """Raised inside a job because another one failed."""


class StopSignal:
    """Tells jobs that their results are no longer wanted."""

    def __init__(self) -> None:
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Asks all jobs to end."""
        self._stopped.set()

    def clear(self) -> None:
        """Allows new jobs."""
        self._stopped.clear()

    def check(self) -> None:
        """Raises `JobStoppedError` after `stop`; a job calls it between its steps."""
        if self._stopped.is_set():
            raise JobStoppedError


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of torch for the block: for loops of small operations, in which a second one only waits. Where another
    program uses its core, they would wait for it in each operation.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def run_in_parallel(jobs: Sequence[Callable[[], T]], at_once: int, signal: StopSignal) -> list[T]:
    """The results of the jobs in their order; at most `at_once` of them run at the same time.

    torch's threads are divided among those that run; fewer jobs at the end have more threads each. The number of
    threads of a job depends on its place alone, so that results do not depend on how long others take. Where a job
    raises, or the caller is interrupted, the others are asked to stop; then the exception of the first job that has one
    is raised. With `at_once` 1 the jobs run one after the other in this thread.
    """
    if min(at_once, len(jobs)) <= 1:
        return [job() for job in jobs]
    import torch

    threads, rest = torch.get_num_threads(), len(jobs) % at_once
    parts = [jobs[: len(jobs) - rest], jobs[len(jobs) - rest :]]
    results: list[T] = []
    try:
        for part in parts:
            torch.set_num_threads(max(1, threads // max(1, min(len(part), at_once))))
            results += _together(part, at_once, signal)
        return results
    finally:
        signal.clear()
        torch.set_num_threads(threads)


def _together(jobs: Sequence[Callable[[], T]], at_once: int, signal: StopSignal) -> list[T]:
    if len(jobs) <= 1:
        return [job() for job in jobs]
    with ThreadPoolExecutor(at_once, thread_name_prefix="hir-job") as pool:
        futures = [pool.submit(job) for job in jobs]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            if not all(future.done() and future.exception() is None for future in futures):
                signal.stop()
                for future in futures:
                    future.cancel()
    failed = [e for f in futures if not f.cancelled() and (e := f.exception()) is not None]
    for error in failed:
        if not isinstance(error, JobStoppedError):
            raise error
    return [future.result() for future in futures]
