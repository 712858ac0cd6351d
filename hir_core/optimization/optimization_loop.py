"""The one optimisation loop: random batches, a cosine schedule, guards, checkpoints and progress in blocks."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.optimization.checkpoints import Stateful, below, load_checkpoint, parameters_of, save_checkpoint
from hir_core.plugins.progress import Progress

PATIENCE_NONFINITE = 20
"""This many steps in a row without a finite gradient end the stage with an error."""

TROUBLES_TOLD = PATIENCE_NONFINITE
"""Of more skipped steps only the number is told."""

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
    resumed_at: int = 0
    """Step from which a checkpoint went on; 0 where the loop began anew."""
    skipped: dict[str, int] = field(default_factory=dict)
    """Steps that were left out because of a value or gradient that was not finite, by the term to blame."""
    troubles: list[str] = field(default_factory=list)
    """The first of them as sentences: step, term, and the place that `locate` named."""
    curves: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Keep:
    """Where a loop keeps its state while it runs, and how often."""

    path: Path
    seconds: float = 30.0


def optimize(
    loss: Callable[[int], Terms],
    optimizer: torch.optim.Optimizer,
    schedule: Schedule,
    *,
    stage: str,
    report: Callable[[Progress], None] = lambda _: None,
    after_step: Callable[[int], bool] | None = None,
    keep: Keep | None = None,
    beside: Stateful | None = None,
    locate: Callable[[int, str], str] | None = None,
    first_step: int = 0,
    total_steps: int = 0,
) -> OptimizationReport:
    """Runs `schedule.steps` steps; `after_step(step)` returning True ends the loop.

    A step whose loss or gradient is not finite is skipped, counted and blamed on a term, and `locate(step, term)` says
    where the trouble lies; parameters never take it in. `PATIENCE_NONFINITE` of them in a row raise `StageError`, with
    the last good state kept. With `keep`, the state (parameters, optimizer, random numbers, curves and `beside`) is
    stored, and a later call with like-shaped parameters goes on from it, bit for bit; a loop that took longer than
    `keep.seconds` and ended is not run again. `first_step` and `total_steps` place the loop in a stage of several (for
    progress only).
    """
    result = OptimizationReport()
    clock = _Clock(stage, report, first_step, total_steps or first_step + schedule.steps)
    rates = [group["lr"] for group in optimizer.param_groups]
    parameters = parameters_of(optimizer)
    start, ended = _resume(keep, optimizer, beside, result, clock)
    in_a_row = 0
    saved = time.monotonic()
    step = start - 1
    for step in range(start, start if ended else schedule.steps):
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
            _note(result, step, blame, locate)
            in_a_row += 1
            if in_a_row >= PATIENCE_NONFINITE:
                if keep:
                    _store(keep, optimizer, step + 1 - in_a_row, beside, result, clock)
                raise StageError(
                    f"stage {stage}: {in_a_row} steps in a row gave no finite gradient, because of {blame!r} "
                    f"({result.troubles[-1]}); leave that term out or lower the learning rate"
                )
        else:
            in_a_row = 0
            optimizer.step()
        clock.record(step, {"loss": total, **terms, "gradient_norm": _gradient_norm(parameters, total)})
        if after_step is not None and after_step(step):
            result.stopped_early = step + 1 < schedule.steps
            break
        if keep and time.monotonic() - saved > keep.seconds:
            _store(keep, optimizer, step + 1, beside, result, clock)
            saved = time.monotonic()
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate
    clock.send()
    if keep and not ended:
        if clock.seconds > keep.seconds or result.resumed_at:
            _store(keep, optimizer, step + 1, beside, result, clock, ended=True)
        else:  # quicker done again than read
            keep.path.unlink(missing_ok=True)
    result.steps = step + 1
    result.seconds = clock.seconds
    result.curves = clock.curves
    return result


def _gradient_norm(parameters: Sequence[Tensor], like: Tensor) -> Tensor:
    """Euclidean norm of all gradients of a step; 0 where there are none."""
    gradients = [p.grad for p in parameters if p.grad is not None]
    return torch.nn.utils.get_total_norm(gradients).to(like) if gradients else torch.zeros_like(like)


def _store(
    keep: Keep,
    optimizer: torch.optim.Optimizer,
    step: int,
    beside: Stateful | None,
    result: OptimizationReport,
    clock: _Clock,
    ended: bool = False,
) -> None:
    clock.send()
    notes = {"skipped": result.skipped, "troubles": result.troubles, "early": result.stopped_early, "ended": ended}
    more = {"notes": np.frombuffer(json.dumps(notes).encode(), np.uint8)}
    more |= {f"curve/{name}": values[:step] for name, values in clock.curves.items()}
    more |= {f"beside/{name}": value for name, value in (beside.state() if beside else {}).items()}
    save_checkpoint(keep.path, optimizer, step, more)


def _resume(
    keep: Keep | None,
    optimizer: torch.optim.Optimizer,
    beside: Stateful | None,
    result: OptimizationReport,
    clock: _Clock,
) -> tuple[int, bool]:
    """The step to go on from, and whether the loop had already ended."""
    found = load_checkpoint(keep.path, optimizer) if keep else None
    if found is None:
        return 0, False
    step, more = found
    notes = json.loads(more["notes"].tobytes())
    result.resumed_at = step
    result.skipped, result.troubles, result.stopped_early = notes["skipped"], notes["troubles"], notes["early"]
    if beside is not None:
        beside.restore(below(more, "beside"))
    clock.restore(step, below(more, "curve"))
    return step, notes["ended"]


def _note(result: OptimizationReport, step: int, term: str, locate: Callable[[int, str], str] | None) -> None:
    result.skipped[term] = result.skipped.get(term, 0) + 1
    if len(result.troubles) >= TROUBLES_TOLD:
        return
    place = locate(step, term) if locate else ""
    result.troubles.append(f"step {step}: {term} is not finite" + (f" at {place}" if place else ""))


def tell_troubles(report: OptimizationReport, warn: Callable[[str], None]) -> None:
    """Warns of steps that were left out: how many, and where the first of them failed."""
    if report.skipped:
        count = sum(report.skipped.values())
        warn(f"{count} of {report.steps} steps were left out: {report.troubles[0]}")


def sum_of(terms: Terms) -> Float[Tensor, ""]:
    """The loss; no terms at all are a zero without gradient."""
    values = list(terms.values())
    if not values:
        return torch.zeros(())
    total = values[0]
    for value in values[1:]:
        total = total + value.to(total)
    return total


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

    def restore(self, step: int, curves: Mapping[str, np.ndarray]) -> None:
        """What was recorded before an interruption, which observers hear in one block."""
        self._step = self._first + step
        self._parts = {name: [values] for name, values in curves.items()}
        self._report(Progress(self._stage, self._step, self._steps, self.seconds, dict(curves), "resumed"))

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
