"""What observers are told while a stage runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Progress:
    """A block of steps of a stage; `scalars` holds one array a name, as long as the block."""

    stage: str
    step: int
    steps: int
    seconds: float
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    message: str = ""

    @property
    def seconds_left(self) -> float:
        """Estimate from the steps done so far; 0 before the first."""
        return self.seconds / self.step * (self.steps - self.step) if self.step else 0.0
