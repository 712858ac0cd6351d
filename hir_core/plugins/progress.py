"""The progress of a running stage, as observers receive it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    import numpy as np

MODEL_FITTED, MODELS_COMPARED = "model_fitted", "models_compared"
"""Milestones of the reflectance stage: a model was fitted and evaluated; a candidate was accepted or rejected."""
LEAST_SHARE_FOR_TIME_LEFT = 0.02
"""Of the steps, from which the time left is extrapolated: the first steps also compile and fill caches."""
PROGRESS_INTERVAL_S = 0.25
"""Shortest time between two reports to observers."""


@dataclass(frozen=True)
class Progress:
    """A block of steps of a stage; `scalars` has one array for each name, as long as the block."""

    stage: str
    step: int
    steps: int
    seconds: float
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    message: str = ""
    phase_seconds: float | None = None
    """Seconds in the current phase, which `step` and `steps` count; None for a stage of one phase."""
    milestone: str = ""
    """The kind of milestone that was reached; timings.json holds its time."""

    @property
    def seconds_left(self) -> float:
        """Extrapolated from the steps so far; 0 where too few of them are done to tell."""
        if self.step < max(1, LEAST_SHARE_FOR_TIME_LEFT * self.steps):
            return 0.0
        spent = self.seconds if self.phase_seconds is None else self.phase_seconds
        return spent / self.step * (self.steps - self.step)


@final
class Throttle:
    """Limits how often something is reported."""

    def __init__(self, interval_s: float = PROGRESS_INTERVAL_S, first_at_once: bool = False) -> None:
        self.interval_s = interval_s
        self._last = float("-inf") if first_at_once else time.monotonic()

    @property
    def ready(self) -> bool:
        """Whether the interval has passed since the last `restart`."""
        return time.monotonic() - self._last >= self.interval_s

    def restart(self) -> None:
        """Something was reported now."""
        self._last = time.monotonic()
