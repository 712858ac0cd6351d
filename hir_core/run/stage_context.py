"""What a stage gets besides its input and its settings."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.plugins.progress import Progress
from hir_core.run.python_warnings import forward_user_warnings

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager


def _silent(_: object) -> None:
    """The default of `report` and `warn`."""


@dataclass(frozen=True)
class StageContext:
    """Device, seed, plugins and workspace of a stage, and where its progress and warnings go."""

    plugins: PluginManager
    workspace: Path
    """A folder for the stage alone; its files survive a resume."""
    options: Mapping[str, Mapping[str, Mapping[str, Any]]] = field(default_factory=dict)
    """Options of renderers: kind, name, option."""
    device: str = "cpu"
    seed: int = 0
    deterministic: bool = False
    checkpoint_seconds: float = 30.0
    """Seconds between checkpoints of a stage."""
    part_seconds: dict[str, float] = field(default_factory=dict)
    """Receives the processor time of parts of the stage, by name; written to timings.json."""
    report: Callable[[Progress], None] = field(default=_silent)
    """Receives progress; throttled by the receiver, so it may be called in every step."""
    warn: Callable[[str], None] = field(default=_silent)
    """Receives one sentence with advice; it is shown to the user and written to run.json."""

    @property
    def checkpoints(self) -> Path:
        """A folder for checkpoints; it is removed when the stage ends."""
        return self.workspace / "checkpoints"


@contextlib.contextmanager
def forward_warnings(context: StageContext) -> Iterator[None]:
    """Turns Python `UserWarning`s of the block into the stage's own warnings: plugins without a context use them."""
    with forward_user_warnings(context.warn):
        yield
