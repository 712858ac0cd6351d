"""Fits on disk: an interrupted model selection repeats no finished fit and resumes the one that was running."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hir_core.optimization.checkpoints import Arrays, read_arrays, write_arrays
from hir_core.optimization.optimization_loop import Checkpointing
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters


@dataclass(frozen=True)
class FitCheckpoint:
    """The files of one fit: its result after it has finished, the state of its loop while it runs."""

    stem: Path
    """Path without suffix."""
    seconds: float
    """Interval at which the state is stored."""

    def result(self) -> Parameters | None:
        """The result of the fit; None if it has not finished."""
        return parameters_from_arrays(read_arrays(self.stem.with_suffix(".npz")))

    def finish(self, parameters: Parameters) -> None:
        """Stores the result and deletes the state."""
        write_arrays(self.stem.with_suffix(".npz"), parameter_arrays(parameters))
        self._state.unlink(missing_ok=True)

    def has_state(self) -> bool:
        """Whether there is a state to resume."""
        return self._state.exists()

    def checkpointing(self, every_steps: int) -> Checkpointing:
        """For the loop of the fit."""
        return Checkpointing(self._state, self.seconds, every_steps)

    @property
    def _state(self) -> Path:
        return self.stem.with_suffix(".state.npz")


def parameter_arrays(parameters: Parameters) -> Arrays:
    """Parameters as arrays by name, without those that are None."""
    named: Sequence[tuple[str, Tensor | None]] = [(f.name, getattr(parameters, f.name)) for f in fields(parameters)]
    return {name: value.detach().cpu().numpy() for name, value in named if value is not None}


def parameters_from_arrays(arrays: Arrays) -> Parameters | None:
    """The inverse of `parameter_arrays`; None if the arrays are incomplete."""
    if not {"light", "diffuse"} <= set(arrays):
        return None
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()}
    return Parameters(*(tensors.get(field.name) for field in fields(Parameters)))  # type: ignore[arg-type]
