"""What observers are told while a stage runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

MODEL_FITTED, MODELS_COMPARED = "fit", "vote"
"""Milestones of the reflectance stage: a model was fitted and judged; a rung of the ladder was kept or refused."""


@dataclass(frozen=True)
class Progress:
    """A block of steps of a stage; `scalars` holds one array a name, as long as the block."""

    stage: str
    step: int
    steps: int
    seconds: float
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    message: str = ""
    phase_seconds: float | None = None
    """Seconds of the phase that `step` and `steps` count, where a stage has several; None: `seconds`."""
    milestone: str = ""
    """Names the kind of thing that has just ended; timings.json holds when."""

    @property
    def seconds_left(self) -> float:
        """Estimate from the steps done so far; 0 before the first."""
        spent = self.seconds if self.phase_seconds is None else self.phase_seconds
        return spent / self.step * (self.steps - self.step) if self.step else 0.0
