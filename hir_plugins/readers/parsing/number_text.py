"""Numbers that a capture's file holds as text."""

from __future__ import annotations

import math

from hir_core.errors import CaptureError


def finite_number(text: str | None, owner: str) -> float:
    """The number; anything but a finite one raises a `CaptureError` that names `owner`."""
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CaptureError(f"{owner}: {text!r} is not a finite number; export the cameras again")
    return value


def finite_numbers(text: str | None, count: int, owner: str) -> list[float]:
    """So many numbers between blanks."""
    words = (text or "").split()
    if len(words) != count:
        raise CaptureError(f"{owner}: {len(words)} numbers where {count} are expected; export the cameras again")
    return [finite_number(word, owner) for word in words]
