"""Independent jobs on several threads."""

from __future__ import annotations

import threading
import time

import pytest
import torch

from hir_core.optimization.parallel_jobs import JobStoppedError, StopSignal, one_thread, run_in_parallel
from tests.fixtures.torch_threads import torch_threads


@pytest.fixture(autouse=True)
def four_threads():  # type: ignore[no-untyped-def]
    with torch_threads(4):
        yield


def test_jobs_run_at_the_same_time_and_keep_their_order() -> None:
    both = threading.Barrier(2, timeout=60)

    def job(number: int) -> int:
        both.wait()  # raises where the other one does not run
        time.sleep(0.02 * (4 - number))
        return number

    assert run_in_parallel([lambda n=n: job(n) for n in range(4)], 2, StopSignal()) == [0, 1, 2, 3]  # type: ignore[misc]


def test_threads_are_divided_and_given_back() -> None:
    found = run_in_parallel([torch.get_num_threads] * 5, 2, StopSignal())
    assert found == [2, 2, 2, 2, 4], "the last one has the threads of both"
    assert torch.get_num_threads() == 4


def test_one_thread_for_a_block_and_all_of_them_after_it() -> None:
    with pytest.raises(ValueError, match="broken"), one_thread():
        assert torch.get_num_threads() == 1
        raise ValueError("broken")
    assert torch.get_num_threads() == 4

    @one_thread()
    def inside() -> int:
        return torch.get_num_threads()

    assert [inside(), inside(), torch.get_num_threads()] == [1, 1, 4]


@pytest.mark.parametrize("at_once", [0, 1])
def test_one_at_a_time_stays_in_the_thread_of_the_caller(at_once: int) -> None:
    assert run_in_parallel([threading.get_ident] * 3, at_once, StopSignal()) == [threading.get_ident()] * 3


def test_nothing_to_do() -> None:
    assert run_in_parallel([], 2, StopSignal()) == []


def test_a_failure_stops_the_others() -> None:
    """The job that fails is the error, not those that it stopped; jobs that had not begun do not begin."""
    signal, begun = StopSignal(), threading.Event()
    ended: list[int] = []

    def endless() -> None:
        begun.set()
        until = time.monotonic() + 60
        while time.monotonic() < until:
            signal.check()
            time.sleep(0.001)
        raise AssertionError("nobody stopped this job")

    def failing() -> None:
        assert begun.wait(60)
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run_in_parallel([endless, failing, lambda: ended.append(1), lambda: ended.append(2)], 2, signal)
    assert len(ended) < 2
    signal.check()  # the next jobs are not stopped
    assert torch.get_num_threads() == 4


def test_a_stopped_signal_raises() -> None:
    signal = StopSignal()
    signal.check()
    signal.stop()
    with pytest.raises(JobStoppedError):
        signal.check()
