"""What is tried again, and what is not."""

from __future__ import annotations

import errno

import pytest

from hir_core.errors import CaptureError, InputError
from hir_plugins.commands.batch.retries import Patience, StoreError, ask, is_infrastructure, is_transient

QUICK = Patience(tries=4, first_seconds=0.001)


def test_waits_grow_to_a_limit_and_are_spread() -> None:
    patience = Patience(tries=9, first_seconds=2.0, factor=4.0, longest_seconds=60.0)
    assert [patience.delay(n) for n in (1, 2, 3, 4, 400)] == [2.0, 8.0, 32.0, 60.0, 60.0]
    assert patience.delay(1, chance=0.0) == 1.0


def test_store_that_refuses_twice_is_asked_three_times() -> None:
    answers = [OSError(errno.EBUSY, "slow down"), TimeoutError("no answer"), b"photograph"]

    def call() -> bytes:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    assert ask(call, "cup.png cannot be read", QUICK) == b"photograph" and not answers


def test_patience_ends_with_one_sentence() -> None:
    asked = []

    def call() -> None:
        asked.append(1)
        raise ConnectionResetError("Connection\nreset by peer")

    with pytest.raises(StoreError, match=r"^cup cannot be read: refused 4 times, last with: Connection reset by peer$"):
        ask(call, "cup cannot be read", QUICK)
    assert len(asked) == 4


@pytest.mark.parametrize(
    ("error", "becomes"),
    [
        (PermissionError(13, "Access Denied"), InputError),
        (FileNotFoundError("gone"), FileNotFoundError),
        (KeyError("ours"), KeyError),
    ],
)
def test_final_answers_are_asked_once(error: Exception, becomes: type[Exception]) -> None:
    asked = []

    def call() -> None:
        asked.append(1)
        raise error

    with pytest.raises(becomes):
        ask(call, "cup", QUICK)
    assert len(asked) == 1


def test_missing_credentials_are_the_users_to_mend() -> None:
    exceptions = pytest.importorskip("botocore.exceptions")
    assert not is_transient(exceptions.NoCredentialsError())
    assert is_transient(exceptions.EndpointConnectionError(endpoint_url="http://127.0.0.1:1"))
    with pytest.raises(InputError, match="Unable to locate credentials"):
        ask(_raise(exceptions.NoCredentialsError()), "s3://shelf", QUICK)


def test_full_disk_below_an_error_of_ours_is_no_fault_of_the_capture() -> None:
    full = CaptureError("cannot write scene")
    full.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    assert is_infrastructure(full) and is_infrastructure(MemoryError()) and is_infrastructure(StoreError("refused"))
    broken = CaptureError("03.png is cut off")
    broken.__cause__ = OSError("image file is truncated")
    assert not is_infrastructure(broken) and not is_infrastructure(ZeroDivisionError())


def _raise(error: Exception):  # type: ignore[no-untyped-def]
    def call() -> None:
        raise error

    return call
