"""A selection of views where all of them would take too long."""

from __future__ import annotations


def evenly_spaced_indices(count: int, wanted: int) -> list[int]:
    """At most `wanted` indices of range(count), evenly spaced from the first to the last."""
    number = min(count, wanted)
    return sorted({round(i * (count - 1) / max(number - 1, 1)) for i in range(number)})
