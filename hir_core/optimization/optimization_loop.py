"""The one optimisation loop: schedule, checkpoints, progress, and steps without a finite gradient."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.optimization.checkpoints import (
    Arrays,
    Stateful,
    arrays_under,
    load_checkpoint,
    optimized_tensors,
    save_checkpoint,
)
from hir_core.optimization.optimization_report import OptimizationReport, ScalarRecorder, Terms
from hir_core.optimization.schedules import Schedule
from hir_core.plugins.progress import Progress

MAX_CONSECUTIVE_NONFINITE_STEPS = 20
"""This many steps in a row without a finite gradient end the stage with an error."""

MAX_DIAGNOSTICS = MAX_CONSECUTIVE_NONFINITE_STEPS
"""Further steps without a finite gradient are only counted."""

ADVICE = "leave that term out or lower the learning rate"


@dataclass(frozen=True)
class Checkpointing:
    """Where a loop stores its state while it runs, and how often."""

    path: Path
    seconds: float = 30.0
    every_steps: int = 1
    """Only states before a step that is a multiple of this are stored."""

    def due(self, step: int, saved: float) -> bool:
        """Whether to store the state before `step`, if the last one was stored at the `saved` time."""
        return step % self.every_steps == 0 and time.monotonic() - saved > self.seconds


def optimize(
    loss: Callable[[int], Terms],
    optimizer: torch.optim.Optimizer,
    schedule: Schedule,
    *,
    stage: str,
    report: Callable[[Progress], None] = lambda _: None,
    after_backward: Callable[[int], None] | None = None,
    after_step: Callable[[int], bool] | None = None,
    checkpointing: Checkpointing | None = None,
    extra_state: Stateful | None = None,
    locate: Callable[[int, str], str] | None = None,
    stop_at_nonfinite: bool = False,
    advice: str = ADVICE,
    first_step: int = 0,
    total_steps: int = 0,
) -> OptimizationReport:
    """Runs `schedule.steps` steps; `after_step(step)` ends the loop by returning True.

    `loss(step)` returns the terms; it may first refresh what it evaluates them with, and must return the same terms if
    it is called again for the same step. `after_backward(step)` may change gradients.

    A step whose loss or gradient is not finite is skipped and counted under the term that caused it; parameters do not
    change. `locate(step, term)` names the views, vertices or texels. After `MAX_CONSECUTIVE_NONFINITE_STEPS` of them in
    a row the loop raises `StageError` with `advice` and stores the last good state. With `stop_at_nonfinite` the first
    one ends the loop instead.

    With `checkpointing`, the state (parameters, optimizer, random numbers, curves, `extra_state`) is stored, and a
    later call with parameters of the same shapes continues from it, bit for bit. A loop that took longer than
    `checkpointing.seconds` and finished is not run again. `first_step` and `total_steps` are the loop's position in a
    stage of several loops, for progress only.
    """
    result = OptimizationReport()
    recorder = ScalarRecorder(stage, report, first_step, total_steps or first_step + schedule.steps)
    rates = [group["lr"] for group in optimizer.param_groups]
    parameters = optimized_tensors(optimizer)
    start, finished = _resume(checkpointing, optimizer, extra_state, result, recorder)
    consecutive = 0
    saved = time.monotonic()
    step = start - 1
    for step in range(start, start if finished else schedule.steps):
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * schedule(step)
        optimizer.zero_grad(set_to_none=True)
        scalars, cause = _backward(loss, step, parameters, after_backward)
        if cause:
            _note(result, step, cause, locate)
            consecutive += 1
            if consecutive >= MAX_CONSECUTIVE_NONFINITE_STEPS and not stop_at_nonfinite:
                last_good = step + 1 - consecutive
                if checkpointing and last_good % checkpointing.every_steps == 0:
                    _store(checkpointing, optimizer, last_good, extra_state, result, recorder)
                raise StageError(
                    f"stage {stage}: {consecutive} steps in a row gave no finite gradient, because of {cause!r} "
                    f"({result.diagnostics[-1]}); {advice}"
                )
        else:
            consecutive = 0
            optimizer.step()
        recorder.record(step, {**scalars, "gradient_norm": _gradient_norm(parameters, scalars["loss"])})
        if (cause and stop_at_nonfinite) or (after_step is not None and after_step(step)):
            result.stopped_early = step + 1 < schedule.steps
            break
        if checkpointing and checkpointing.due(step + 1, saved):
            _store(checkpointing, optimizer, step + 1, extra_state, result, recorder)
            saved = time.monotonic()
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate
    recorder.send()
    if checkpointing and not finished:
        if recorder.seconds > checkpointing.seconds or result.resumed_at:
            _store(checkpointing, optimizer, step + 1, extra_state, result, recorder, finished=True)
        else:  # to run it again is faster than to read it
            checkpointing.path.unlink(missing_ok=True)
    result.steps = step + 1
    result.seconds = recorder.seconds
    result.curves = recorder.curves
    return result


def _backward(
    loss: Callable[[int], Terms], step: int, parameters: Sequence[Tensor], after_backward: Callable[[int], None] | None
) -> tuple[dict[str, Tensor], str]:
    """Leaves gradients; returns the scalars of a step and the term that is not finite, "" if all are.

    The scalars have no graph: it may hold large caches, which must be free before the next step computes new ones.
    """
    terms = loss(step)
    total = sum_of(terms)
    scalars = {"loss": total.detach(), **{name: term.detach() for name, term in terms.items()}}
    if not bool(torch.isfinite(total)):
        return scalars, next((n for n, t in terms.items() if not bool(torch.isfinite(t))), "sum")
    if total.requires_grad:
        total.backward()
        if after_backward is not None:
            after_backward(step)
        if not all(bool(torch.isfinite(p.grad).all()) for p in parameters if p.grad is not None):
            return scalars, _term_with_nonfinite_gradient(loss(step), parameters)
    return scalars, ""


def _gradient_norm(parameters: Sequence[Tensor], like: Tensor) -> Tensor:
    """Euclidean norm of all gradients of a step; 0 where there are none."""
    gradients = [p.grad for p in parameters if p.grad is not None]
    return torch.nn.utils.get_total_norm(gradients).to(like) if gradients else torch.zeros_like(like)


def _store(
    checkpointing: Checkpointing,
    optimizer: torch.optim.Optimizer,
    step: int,
    extra_state: Stateful | None,
    result: OptimizationReport,
    recorder: ScalarRecorder,
    finished: bool = False,
) -> None:
    recorder.send()
    notes = {
        "skipped": result.skipped,
        "diagnostics": result.diagnostics,
        "stopped_early": result.stopped_early,
        "finished": finished,
    }
    extra: Arrays = {"notes": np.frombuffer(json.dumps(notes).encode(), np.uint8)}
    extra |= {f"curve/{name}": values[:step] for name, values in recorder.curves.items()}
    extra |= {f"state/{name}": value for name, value in (extra_state.state() if extra_state else {}).items()}
    save_checkpoint(checkpointing.path, optimizer, step, extra)


def _resume(
    checkpointing: Checkpointing | None,
    optimizer: torch.optim.Optimizer,
    extra_state: Stateful | None,
    result: OptimizationReport,
    recorder: ScalarRecorder,
) -> tuple[int, bool]:
    """The step to continue from, and whether the loop had already finished."""
    checkpoint = load_checkpoint(checkpointing.path, optimizer) if checkpointing else None
    if checkpoint is None:
        return 0, False
    step, extra = checkpoint
    notes = json.loads(extra["notes"].tobytes())
    result.resumed_at = step
    result.skipped, result.diagnostics = notes["skipped"], notes["diagnostics"]
    result.stopped_early = notes["stopped_early"]
    if extra_state is not None:
        extra_state.restore(arrays_under(extra, "state"))
    recorder.restore(step, arrays_under(extra, "curve"))
    return step, notes["finished"]


def _note(result: OptimizationReport, step: int, term: str, locate: Callable[[int, str], str] | None) -> None:
    result.skipped[term] = result.skipped.get(term, 0) + 1
    if len(result.diagnostics) >= MAX_DIAGNOSTICS:
        return
    location = locate(step, term) if locate else ""
    result.diagnostics.append(f"step {step}: {term} is not finite" + (f" at {location}" if location else ""))


def warn_of_skipped_steps(report: OptimizationReport, warn: Callable[[str], None], of_what: str = "") -> None:
    """Warns if steps were skipped: how many (of `of_what`), and the diagnostics of the first."""
    if report.skipped:
        count = sum(report.skipped.values())
        what = f" of {of_what}" if of_what else ""
        warn(f"{count} of {report.steps} steps{what} were skipped: {report.diagnostics[0]}")


def sum_of(terms: Terms) -> Float[Tensor, ""]:
    """The loss; without terms a zero without gradient."""
    values = list(terms.values())
    if not values:
        return torch.zeros(())
    total = values[0]
    for value in values[1:]:
        total = total + value.to(total)
    return total


def _term_with_nonfinite_gradient(terms: Terms, parameters: Sequence[Tensor]) -> str:
    for name, term in terms.items():
        if term.requires_grad:
            gradients = torch.autograd.grad(term, parameters, retain_graph=True, allow_unused=True)
            if not all(bool(torch.isfinite(g).all()) for g in gradients if g is not None):
                return name
    return "sum"
