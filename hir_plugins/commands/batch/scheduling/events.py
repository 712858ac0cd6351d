"""Events of a batch, for its listeners, and the tasks that are running."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.scheduling.messages import ProgressMessage


@dataclass(frozen=True)
class BatchEvent:
    """Something that happened in a batch, such as `capture_finished`."""

    name: str
    capture: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class RunningTask:
    """A task that was submitted to Ray."""

    job: CaptureJob
    submitted: float
    """`time.monotonic()` in seconds."""
    progress: ProgressMessage | None = None
    """The last progress message; None until the task starts."""
