"""Warnings of libraries and plugins, which know no other way to tell the user something."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def forward_user_warnings(say: Callable[[str], None]) -> Iterator[None]:
    """Passes each `UserWarning` of the block to `say`, once, on one line; others are dropped. The command line shows
    none by itself.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", UserWarning)
        try:
            yield
        finally:  # what was said before an error may explain it
            for warning in caught:
                if issubclass(warning.category, UserWarning):
                    say(" ".join(str(warning.message).split()))
