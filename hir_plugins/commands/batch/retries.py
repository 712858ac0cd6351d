"""Which errors are transient, and how often and after which wait a failed operation is retried."""

from __future__ import annotations

import errno
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, TypeVar

from hir_core.errors import HirError, InputError, MissingExtraError

Value = TypeVar("Value")

PERMANENT_ERRORS: Final = (
    FileNotFoundError,
    FileExistsError,
    PermissionError,
    IsADirectoryError,
    NotADirectoryError,
)
"""Answers of a store that do not change if the request is repeated."""

PERMANENT_ERROR_NAMES: Final = (
    "NoCredentialsError",
    "PartialCredentialsError",
    "ParamValidationError",
    "NoAuthTokenError",
)
"""Errors of storage libraries that the user has to correct."""

STORAGE_LIBRARIES: Final = ("botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "requests", "urllib3", "adlfs")
"""Top-level packages whose exceptions mean that a request to a store failed."""

NODE_ERROR_CODES: Final = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EIO,
    errno.ESTALE,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
)
"""`errno` values of failures that may not occur on another node, or on the same node later."""


class StoreError(HirError):
    """Every attempt of a request to a store failed; a later one may succeed."""


@dataclass(frozen=True)
class RetryPolicy:
    """The number of attempts and the waits between them: exponential backoff with jitter, in seconds."""

    attempts: int
    initial_wait_s: float
    factor: float = 3.0
    max_wait_s: float = 120.0

    def wait_s(self, failures: int, jitter: float = 1.0) -> float:
        """Seconds to wait after `failures` (≥ 1) failed attempts.

        `jitter` in 0…1 scales the wait between half and all of it, so that workers that failed together do not retry
        together.
        """
        wait = min(self.initial_wait_s * self.factor ** min(failures - 1, 60), self.max_wait_s)
        return wait * (0.5 + 0.5 * jitter)


STORE_RETRIES: Final = RetryPolicy(attempts=6, initial_wait_s=0.2, factor=2.5, max_wait_s=10.0)
"""For one request to a store; it fails after 6 to 13 seconds."""


def call_with_retries(call: Callable[[], Value], failure: str, policy: RetryPolicy = STORE_RETRIES) -> Value:
    """Calls a store and repeats the call after transient errors.

    `failure` begins the error message, such as "s3://a/b cannot be read". Raises `StoreError` after the last attempt,
    `InputError` for permanent errors of the store, and `FileNotFoundError` and errors of other origin as they are.
    """
    try:
        from tenacity import Retrying, retry_if_exception, stop_after_attempt
    except ImportError:
        raise MissingExtraError("hir batch needs tenacity; install it with: pip install 'hir[batch]'") from None
    retrying = Retrying(
        stop=stop_after_attempt(policy.attempts),
        wait=lambda state: policy.wait_s(state.attempt_number, random.random()),
        retry=retry_if_exception(is_transient),
        reraise=True,
    )
    try:
        return retrying(call)
    except FileNotFoundError:
        raise
    except Exception as error:
        if is_transient(error):
            message = f"{failure}: {policy.attempts} attempts failed, the last one with: {one_line(error)}"
            raise StoreError(message) from error
        if is_storage_error(error):
            raise InputError(f"{failure}: {one_line(error)}; check the address and your permissions") from error
        raise


def is_transient(error: BaseException) -> bool:
    """Whether the same request to a store may succeed later."""
    if isinstance(error, PERMANENT_ERRORS) or type(error).__name__ in PERMANENT_ERROR_NAMES:
        return False
    return is_storage_error(error)


def is_storage_error(error: BaseException) -> bool:
    """Whether a store or the connection to it raised the exception."""
    return isinstance(error, OSError) or type(error).__module__.partition(".")[0] in STORAGE_LIBRARIES


def is_infrastructure_error(error: BaseException) -> bool:
    """Whether a stage failed for a reason outside its capture: a store, a full disk, too little memory."""
    for cause in causes(error):
        if isinstance(cause, StoreError | MemoryError):
            return True
        if isinstance(cause, OSError) and cause.errno in NODE_ERROR_CODES:
            return True
    return False


def causes(error: BaseException) -> Iterator[BaseException]:
    """An exception and the exceptions that caused it."""
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__


def one_line(error: BaseException) -> str:
    """The message of an exception without line breaks; the name of its type if there is no message."""
    return " ".join(str(error).split()) or type(error).__name__
