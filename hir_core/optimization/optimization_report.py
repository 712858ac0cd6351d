"""What an optimisation loop records: a scalar for each step and term, sent to observers in groups of steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.plugins.progress import Progress, Throttle

Terms = Mapping[str, Float[Tensor, ""]]
"""Weighted terms of a loss by name; their sum is minimised."""

Curves = dict[str, NDArray[np.float32]]


@dataclass
class OptimizationReport:
    """What a loop did: one scalar for each step and term, and the steps without a finite gradient."""

    steps: int = 0
    seconds: float = 0.0
    stopped_early: bool = False
    resumed_at: int = 0
    """The step at which a checkpoint was resumed; 0 if the loop started anew."""
    skipped: dict[str, int] = field(default_factory=dict)
    """Number of steps without a finite value or gradient, by the term that caused it."""
    diagnostics: list[str] = field(default_factory=list)
    """The first of these steps as sentences: step, term, and what `locate` returned."""
    curves: Curves = field(default_factory=dict)


class ScalarRecorder:
    """Collects scalars and sends them to observers; reads them from the device only then."""

    def __init__(self, stage: str, report: Callable[[Progress], None], first_step: int, steps: int) -> None:
        self._stage, self._report, self._first, self._steps = stage, report, first_step, steps
        self._pending: list[dict[str, Tensor]] = []
        self._parts: dict[str, list[NDArray[np.float32]]] = {}
        self._start, self._throttle = time.monotonic(), Throttle()
        self._step = first_step

    @property
    def seconds(self) -> float:
        """Time since the loop began."""
        return time.monotonic() - self._start

    @property
    def curves(self) -> Curves:
        """All scalars that were sent."""
        return {name: np.concatenate(parts) for name, parts in self._parts.items()}

    def record(self, step: int, scalars: Terms) -> None:
        """Adds the scalars of a step."""
        self._step = self._first + step + 1
        self._pending.append({name: value.detach() for name, value in scalars.items()})
        if self._throttle.ready:
            self.send()

    def restore(self, step: int, curves: Mapping[str, NDArray[np.float32]]) -> None:
        """Takes over what was recorded before an interruption; observers receive it as one group of steps."""
        self._step = self._first + step
        self._parts = {name: [values] for name, values in curves.items()}
        self._report(Progress(self._stage, self._step, self._steps, self.seconds, dict(curves), "resumed"))

    def send(self) -> None:
        """Sends what was recorded since the last call."""
        if not self._pending:
            return
        names = list(self._pending[0])
        sent = {n: np.asarray([float(row[n]) for row in self._pending if n in row], dtype=np.float32) for n in names}
        for name, values in sent.items():
            self._parts.setdefault(name, []).append(values)
        self._pending = []
        self._throttle.restart()
        self._report(Progress(self._stage, self._step, self._steps, self.seconds, sent))
