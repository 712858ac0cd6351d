"""Seconds that are left, of a capture and of a batch, from the groups that have ended so far."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median
from typing import Final

from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.stage_groups import GROUPS

SAMPLES: Final = 200
"""Groups that a median looks back to."""


class Estimate:
    """Learns how long each group takes."""

    def __init__(self) -> None:
        self._seen: dict[str, list[float]] = {group.name: [] for group in GROUPS}

    def learn(self, group: int, seconds: float) -> None:
        """A group ended, after that many seconds on its worker."""
        seen = self._seen[GROUPS[group].name]
        seen.append(seconds)
        del seen[:-SAMPLES]

    def of(self, group: int) -> float | None:
        """The median of a group; None before one ended."""
        seen = self._seen[GROUPS[group].name]
        return median(seen) if seen else None

    def left(self, chain: Chain, running: float = 0.0) -> float | None:
        """Seconds until a capture is done, given how long its group has been running; None where nothing is known."""
        if chain.state in ("done", "failed"):
            return 0.0
        whole = [self.of(group) for group in range(chain.group, len(GROUPS))]
        known = [seconds for seconds in whole if seconds is not None]
        if len(known) < len(whole):
            return None
        return max(known[0] - running, 0.0) + sum(known[1:])

    def batch_left(self, begun: Iterable[Chain], untouched: int, at_once: int) -> float | None:
        """Seconds until the captures that are begun and those that are not are done, were `at_once` always at work."""
        whole = [self.of(group) for group in range(len(GROUPS))]
        known = [seconds for seconds in whole if seconds is not None]
        if len(known) < len(whole):
            return None
        left = [self.left(chain) for chain in begun]
        return (sum(value for value in left if value is not None) + untouched * sum(known)) / max(at_once, 1)
