"""Early stopping: the state of the lowest held-out error, and when to stop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.optimization.checkpoints import Arrays

CHECKS_WITHOUT_GAIN = 6
"""The fit may stop when this many evaluations in a row lowered the error by less than `LEAST_GAIN`."""

LEAST_GAIN = 0.001
"""Relative."""


class BestState:
    """The state of the lowest held-out error so far."""

    def __init__(self, state: Tensor) -> None:
        self.tensor = state.detach().clone()
        self.error: float | None = None
        """None until the first evaluation."""
        self._checks_without_gain = 0

    def update(self, state: Tensor, error: float) -> bool:
        """Stores the state if its error is lower; True when the error has stopped falling."""
        if self.error is None or error < self.error:
            gained = self.error is None or error < (1 - LEAST_GAIN) * self.error
            self._checks_without_gain = 0 if gained else self._checks_without_gain + 1
            self.tensor, self.error = state.detach().clone(), error
        else:
            self._checks_without_gain += 1
        return self._checks_without_gain >= CHECKS_WITHOUT_GAIN

    def state(self) -> Arrays:
        """For a checkpoint."""
        error = np.nan if self.error is None else self.error
        checks = np.asarray(self._checks_without_gain)
        return {"state": self.tensor.cpu().numpy(), "error": np.asarray(error), "checks": checks}

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """From a checkpoint."""
        self.tensor = torch.from_numpy(state["state"]).to(self.tensor)
        error = float(state["error"])
        self.error = None if np.isnan(error) else error
        self._checks_without_gain = int(state["checks"])
