"""What a benchmark was asked for, and when a case is too large for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hir_plugins.commands.bench.measurement import REPEATS
from hir_plugins.commands.bench.results.bench_result import Timing

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager


@dataclass(frozen=True)
class Plan:
    """Options of `hir bench`."""

    plugins: PluginManager
    captures: tuple[Path, ...] = ()
    """Captures with known cameras for the suites that fit; those with `reference.obj` are judged by it."""
    quick: bool = False
    """The smallest sizes alone."""
    repeats: int = REPEATS
    peers: bool = True
    """Other programs on the same task, where they are installed."""
    limit_seconds: float = 30.0
    """A case that would take longer than this by the growth from the case before is left out, and said so."""
    workspace: Path = field(default_factory=Path)
    """Where runs may be kept."""

    def too_slow(self, last: Timing | None, growth: float) -> bool:
        """Would a run take longer than the limit, `growth` times as long as the last one?"""
        return last is not None and growth * last.median > self.limit_seconds

    def left_out(self, last: Timing) -> str:
        """The note of such a case."""
        return f"left out: the size before took {last.median:.1f} s"
