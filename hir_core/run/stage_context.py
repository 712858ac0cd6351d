"""What a stage is given beside its input and its settings."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.plugins.progress import Progress

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager


def _silent(_: object) -> None:
    """Nobody listens."""


@dataclass(frozen=True)
class StageContext:
    """Where a stage runs, who listens, and where it may keep files."""

    plugins: PluginManager
    workspace: Path
    """A folder of the stage's own; what is left there survives a resume."""
    options: Mapping[str, Mapping[str, Mapping[str, Any]]] = field(default_factory=dict)
    """Options of renderers: kind, name, option."""
    device: str = "cpu"
    seed: int = 0
    deterministic: bool = False
    checkpoint_seconds: float = 30.0
    """How often a stage should keep its state."""
    report: Callable[[Progress], None] = field(default=_silent)
    """Told of progress; cheap, throttles by itself."""
    warn: Callable[[str], None] = field(default=_silent)
    """One sentence that advises; shown to the user and written into run.json."""

    @property
    def checkpoints(self) -> Path:
        """A folder for the state of a stage under way; it is removed when the stage has ended."""
        return self.workspace / "checkpoints"


@contextlib.contextmanager
def passed_on(context: StageContext) -> Iterator[None]:
    """Plugins without a context warn as Python does; the user and run.json hear it as they hear any warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", UserWarning)
        yield
    for warning in caught:
        if issubclass(warning.category, UserWarning):
            context.warn(" ".join(str(warning.message).split()))
