"""Which errors are retried, how often, and what is raised in the end."""

from __future__ import annotations

import errno

import pytest

from hir_core.errors import CaptureError, InputError
from hir_plugins.commands.batch.retries import (
    RetryPolicy,
    StoreError,
    call_with_retries,
    is_infrastructure_error,
    is_transient,
)

QUICK = RetryPolicy(attempts=4, initial_wait_s=0.001)


def test_waits_grow_to_a_limit_and_have_jitter() -> None:
    policy = RetryPolicy(attempts=9, initial_wait_s=2.0, factor=4.0, max_wait_s=60.0)
    assert [policy.wait_s(n) for n in (1, 2, 3, 4, 400)] == [2.0, 8.0, 32.0, 60.0, 60.0]
    assert policy.wait_s(1, jitter=0.0) == 1.0


def test_third_attempt_succeeds_after_two_transient_errors() -> None:
    answers = [OSError(errno.EBUSY, "slow down"), TimeoutError("no answer"), b"photograph"]

    def call() -> bytes:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    assert call_with_retries(call, "cup.png cannot be read", QUICK) == b"photograph" and not answers


def test_last_attempt_fails_with_one_sentence() -> None:
    calls = []

    def call() -> None:
        calls.append(1)
        raise ConnectionResetError("Connection\nreset by peer")

    with pytest.raises(
        StoreError, match=r"^cup cannot be read: 4 attempts failed, the last one with: Connection reset by peer$"
    ):
        call_with_retries(call, "cup cannot be read", QUICK)
    assert len(calls) == 4


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (PermissionError(13, "Access Denied"), InputError),
        (FileNotFoundError("gone"), FileNotFoundError),
        (KeyError("ours"), KeyError),
    ],
)
def test_permanent_errors_are_not_retried(error: Exception, raised: type[Exception]) -> None:
    calls = []

    def call() -> None:
        calls.append(1)
        raise error

    with pytest.raises(raised):
        call_with_retries(call, "cup", QUICK)
    assert len(calls) == 1


def test_missing_credentials_are_an_input_error() -> None:
    exceptions = pytest.importorskip("botocore.exceptions")
    assert not is_transient(exceptions.NoCredentialsError())
    assert is_transient(exceptions.EndpointConnectionError(endpoint_url="http://127.0.0.1:1"))
    with pytest.raises(InputError, match="Unable to locate credentials"):
        call_with_retries(_raise(exceptions.NoCredentialsError()), "s3://captures", QUICK)


def test_full_disk_that_caused_another_error_is_an_infrastructure_error() -> None:
    full = CaptureError("cannot write scene")
    full.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    assert (
        is_infrastructure_error(full)
        and is_infrastructure_error(MemoryError())
        and is_infrastructure_error(StoreError("refused"))
    )
    broken = CaptureError("03.png is cut off")
    broken.__cause__ = OSError("image file is truncated")
    assert not is_infrastructure_error(broken) and not is_infrastructure_error(ZeroDivisionError())


def _raise(error: Exception):  # type: ignore[no-untyped-def]
    def call() -> None:
        raise error

    return call
