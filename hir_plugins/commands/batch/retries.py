"""What is tried again, how often and after how long; everything else is final."""

from __future__ import annotations

import errno
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, TypeVar

from hir_core.errors import HirError, InputError

Value = TypeVar("Value")

FINAL: Final = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
"""Answers of a store that asking again does not change."""

FINAL_NAMES: Final = ("NoCredentialsError", "PartialCredentialsError", "ParamValidationError", "NoAuthTokenError")
"""Errors of storage libraries that are the user's to mend."""

STORAGE_LIBRARIES: Final = ("botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "requests", "urllib3", "adlfs")
"""Top-level packages whose exceptions mean that a store did not answer as it should."""

NODE_TROUBLE: Final = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EIO,
    errno.ESTALE,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
)
"""Operating system errors that another node, or the same one later, may not have."""


class StoreError(HirError):
    """A store refused or did not answer, again and again; later it may."""


@dataclass(frozen=True)
class Patience:
    """How often something is tried, and the seconds between: each wait `factor` times the one before, up to a limit."""

    tries: int
    first_seconds: float
    factor: float = 3.0
    longest_seconds: float = 120.0

    def delay(self, failures: int, chance: float = 1.0) -> float:
        """Seconds to wait after that many failures (1 or more); `chance` in 0…1 takes up to half of it away, so that
        workers that were refused together do not come back together.
        """
        whole = min(self.first_seconds * self.factor ** min(failures - 1, 60), self.longest_seconds)
        return whole * (0.5 + 0.5 * chance)


ASK_STORE: Final = Patience(tries=6, first_seconds=0.2, factor=2.5, longest_seconds=10.0)
"""One request to a store: given up after about 15 seconds."""


def ask(call: Callable[[], Value], what: str, patience: Patience = ASK_STORE) -> Value:
    """The answer of a store, asked again while it refuses; `StoreError` when patience ends.

    What is not there raises `FileNotFoundError`, what is not allowed `InputError` with one sentence.
    """
    for failures in range(1, patience.tries + 1):
        try:
            return call()
        except FileNotFoundError:
            raise
        except Exception as error:
            if not is_transient(error):
                if is_storage_error(error):
                    raise InputError(f"{what}: {one_line(error)}; check the address and your rights") from error
                raise
            if failures == patience.tries:
                raise StoreError(f"{what}: refused {failures} times, last with: {one_line(error)}") from error
            time.sleep(patience.delay(failures, random.random()))
    raise AssertionError("a patience has at least one try")


def is_transient(error: BaseException) -> bool:
    """Whether the same request may succeed later."""
    if isinstance(error, FINAL) or type(error).__name__ in FINAL_NAMES:
        return False
    return is_storage_error(error)


def is_storage_error(error: BaseException) -> bool:
    """Whether an exception comes from a store or from the way to it."""
    return isinstance(error, OSError) or type(error).__module__.partition(".")[0] in STORAGE_LIBRARIES


def is_infrastructure(error: BaseException) -> bool:
    """Whether a failed stage says nothing about its capture: a store, a full disk, too little memory."""
    for cause in causes(error):
        if isinstance(cause, StoreError | MemoryError):
            return True
        if isinstance(cause, OSError) and cause.errno in NODE_TROUBLE:
            return True
    return False


def causes(error: BaseException) -> Iterator[BaseException]:
    """An exception and those that led to it."""
    found: BaseException | None = error
    while found is not None:
        yield found
        found = found.__cause__ or found.__context__


def one_line(error: BaseException) -> str:
    """An exception's text without line breaks; its type where it has none."""
    return " ".join(str(error).split()) or type(error).__name__
