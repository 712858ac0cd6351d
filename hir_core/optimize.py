"""The one optimisation loop: random batches, a cosine schedule, guards, checkpoints and progress in blocks."""
# ruff: noqa: TID253 - the heavy side of hir imports this module

from __future__ import annotations

import math
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hir_exporters.atomic import atomic_write
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.progress import Progress

PATIENCE_NONFINITE = 20
"""This many steps in a row without a finite gradient end the stage with an error."""

BLOCK_SECONDS = 0.25
"""Observers hear of progress at most this often."""

Terms = Mapping[str, Float[Tensor, ""]]
"""Weighted terms of a loss; their sum is what is minimised."""


@dataclass(frozen=True)
class Batches:
    """Random batches of `size` of `count` things, each once an epoch; a function of the step, so a resume repeats
    it.
    """

    count: int
    size: int
    seed: int = 0

    def __call__(self, step: int) -> list[int]:
        """Indices of the batch of one step; all of them in order when a batch holds them all."""
        if self.size >= self.count:
            return list(range(self.count))
        start = step * self.size
        chosen: list[int] = []
        while len(chosen) < self.size:
            epoch, place = divmod(start + len(chosen), self.count)
            order = np.random.default_rng((self.seed, epoch)).permutation(self.count)
            # a batch that spans two epochs may not hold a thing twice
            fresh = [int(i) for i in order[place:] if int(i) not in chosen]
            taken = fresh[: self.size - len(chosen)]
            chosen += taken if taken else [next(i for i in range(self.count) if i not in chosen)]
        return chosen


@dataclass(frozen=True)
class Schedule:
    """Learning rate as a factor of each group's own: linear warm-up, then a half cosine down to `end`."""

    steps: int
    warmup: int = 0
    end: float = 1.0

    def __call__(self, step: int) -> float:
        if step < self.warmup:
            return (step + 1) / self.warmup
        progress = (step - self.warmup) / max(1, self.steps - self.warmup)
        return self.end + (1 - self.end) * 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))


@dataclass
class OptimizationReport:
    """What a loop did: one scalar a step and term, and what the guards caught."""

    steps: int = 0
    seconds: float = 0.0
    stopped_early: bool = False
    skipped: dict[str, int] = field(default_factory=dict)
    """Steps that were left out because of a value or gradient that was not finite, by the term to blame."""
    curves: dict[str, np.ndarray] = field(default_factory=dict)


def optimize(
    loss: Callable[[int], Terms],
    optimizer: torch.optim.Optimizer,
    schedule: Schedule,
    *,
    stage: str,
    report: Callable[[Progress], None] = lambda _: None,
    after_step: Callable[[int], bool] | None = None,
    checkpoint: Path | None = None,
    checkpoint_seconds: float = 30.0,
    first_step: int = 0,
    total_steps: int = 0,
) -> OptimizationReport:
    """Runs `schedule.steps` steps; `after_step(step)` returning True ends the loop.

    A step whose loss or gradient is not finite is skipped, counted and blamed on a term; parameters never take it in.
    `PATIENCE_NONFINITE` of them in a row raise `StageError`. With `checkpoint`, the state is kept there and a
    later call with like-shaped parameters goes on from it; the file is removed when the loop ends. `first_step` and
    `total_steps` place the loop in a stage of several (for progress only).
    """
    clock = _Clock(stage, report, first_step, total_steps or first_step + schedule.steps)
    rates = [group["lr"] for group in optimizer.param_groups]
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    start = load_checkpoint(checkpoint, optimizer) if checkpoint else 0
    result = OptimizationReport()
    in_a_row = 0
    saved = time.monotonic()
    step = start - 1
    for step in range(start, schedule.steps):
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * schedule(step)
        optimizer.zero_grad(set_to_none=True)
        terms = loss(step)
        total = sum_of(terms)
        blame = ""
        if not bool(torch.isfinite(total)):
            blame = next((n for n, t in terms.items() if not bool(torch.isfinite(t))), "sum")
        elif total.requires_grad:
            total.backward()
            if not all(bool(torch.isfinite(p.grad).all()) for p in parameters if p.grad is not None):
                blame = _blame_gradient(loss(step), parameters)
        if blame:
            result.skipped[blame] = result.skipped.get(blame, 0) + 1
            in_a_row += 1
            if in_a_row >= PATIENCE_NONFINITE:
                raise StageError(
                    f"stage {stage}: {in_a_row} steps in a row gave no finite gradient, because of {blame!r}; "
                    f"leave that term out or lower the learning rate"
                )
        else:
            in_a_row = 0
            optimizer.step()
        clock.record(step, {"loss": total, **terms})
        if after_step is not None and after_step(step):
            result.stopped_early = step + 1 < schedule.steps
            break
        if checkpoint and time.monotonic() - saved > checkpoint_seconds:
            save_checkpoint(checkpoint, optimizer, step + 1)
            saved = time.monotonic()
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate
    clock.send()
    if checkpoint:
        checkpoint.unlink(missing_ok=True)
    result.steps = step + 1 - start
    result.seconds = clock.seconds
    result.curves = clock.curves
    return result


def sum_of(terms: Terms) -> Float[Tensor, ""]:
    """The loss; no terms at all are a zero without gradient."""
    values = list(terms.values())
    if not values:
        return torch.zeros(())
    total = values[0]
    for value in values[1:]:
        total = total + value.to(total)
    return total


def save_checkpoint(path: Path, optimizer: torch.optim.Optimizer, step: int) -> None:
    """Writes parameters, the optimizer's state and the next step as plain arrays, complete or not at all."""
    arrays: dict[str, np.ndarray] = {"step": np.asarray(step)}
    for i, parameter in enumerate(_parameters(optimizer)):
        arrays[f"parameter/{i}"] = parameter.detach().cpu().numpy()
        for name, value in optimizer.state.get(parameter, {}).items():
            arrays[f"state/{i}/{name}"] = (
                value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
            )
    with atomic_write(path) as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def load_checkpoint(path: Path, optimizer: torch.optim.Optimizer) -> int:
    """Restores what `save_checkpoint` wrote and returns the next step; 0, with nothing changed, where none fits."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, zipfile.BadZipFile):
        return 0
    parameters = _parameters(optimizer)
    shapes = [arrays.get(f"parameter/{i}", np.empty(0)).shape for i in range(len(parameters))]
    if "step" not in arrays or shapes != [tuple(p.shape) for p in parameters]:
        return 0
    for i, parameter in enumerate(parameters):
        with torch.no_grad():
            parameter.copy_(torch.from_numpy(arrays[f"parameter/{i}"]))
        prefix = f"state/{i}/"
        state: dict[str, Any] = {}
        for name, array in arrays.items():
            if name.startswith(prefix):
                value = torch.from_numpy(np.array(array))
                # Adam keeps its count of steps on the CPU
                state[name[len(prefix) :]] = value if value.ndim == 0 else value.to(parameter.device)
        if state:
            optimizer.state[parameter] = state
    return int(arrays["step"])


def _parameters(optimizer: torch.optim.Optimizer) -> list[Tensor]:
    return [p for group in optimizer.param_groups for p in group["params"]]


def _blame_gradient(terms: Terms, parameters: Sequence[Tensor]) -> str:
    """The first term whose own gradient is not finite."""
    for name, term in terms.items():
        if term.requires_grad:
            gradients = torch.autograd.grad(term, parameters, retain_graph=True, allow_unused=True)
            if not all(bool(torch.isfinite(g).all()) for g in gradients if g is not None):
                return name
    return "sum"


class _Clock:
    """Collects a scalar a step and term and hands them over in blocks; reads them from the device only then."""

    def __init__(self, stage: str, report: Callable[[Progress], None], first_step: int, steps: int) -> None:
        self._stage, self._report, self._first, self._steps = stage, report, first_step, steps
        self._block: list[dict[str, Tensor]] = []
        self._parts: dict[str, list[np.ndarray]] = {}
        self._start = self._sent = time.monotonic()
        self._step = first_step

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start

    @property
    def curves(self) -> dict[str, np.ndarray]:
        return {name: np.concatenate(parts) for name, parts in self._parts.items()}

    def record(self, step: int, scalars: Terms) -> None:
        self._step = self._first + step + 1
        self._block.append({name: value.detach() for name, value in scalars.items()})
        if time.monotonic() - self._sent >= BLOCK_SECONDS:
            self.send()

    def send(self) -> None:
        if not self._block:
            return
        names = list(self._block[0])
        block = {n: np.asarray([float(row[n]) for row in self._block if n in row], dtype=np.float32) for n in names}
        for name, values in block.items():
            self._parts.setdefault(name, []).append(values)
        self._block = []
        self._sent = time.monotonic()
        self._report(Progress(self._stage, self._step, self._steps, self.seconds, block))
