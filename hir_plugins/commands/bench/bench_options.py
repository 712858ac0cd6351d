"""The options of a benchmark, and the rule for cases that would take too long."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hir_plugins.commands.bench.measurement import REPEATS
from hir_plugins.commands.bench.results.bench_result import Timing

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.bench.materials_options import MaterialsOptions


@dataclass(frozen=True)
class BenchOptions:
    """The options of `hir bench`."""

    plugins: PluginManager
    captures: tuple[Path, ...] = ()
    """Captures with known cameras for the suites that fit; those with `reference.obj` are compared with it."""
    quick: bool = False
    """Whether only the smallest sizes are measured."""
    repeats: int = REPEATS
    peers: bool = True
    """Whether other programs are measured on the same task, if they are installed."""
    limit_seconds: float = 30.0
    """A case that is expected to take longer is omitted with a note."""
    workspace: Path = field(default_factory=Path)
    """The folder for captures and runs of the suites that reconstruct."""
    materials: MaterialsOptions | None = None
    """Of the materials suite; None where its captures are not named."""

    def exceeds_limit(self, previous: Timing | None, growth: float) -> bool:
        """Whether a case that takes `growth` times as long as the previous one would exceed the time limit."""
        return previous is not None and growth * previous.median > self.limit_seconds

    def omission_note(self, previous: Timing) -> str:
        """The note of an omitted case."""
        return f"omitted: the size before took {previous.median:.1f} s"
