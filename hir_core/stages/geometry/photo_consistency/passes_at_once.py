"""Passes of one resolution side by side: a step gains nothing from a second thread, a second pass does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.optimization.parallel_jobs import StopSignal, run_in_parallel
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh

MAX_PASSES_AT_ONCE = 2
"""There are two candidates."""

T = TypeVar("T")
Iou = Callable[[Mesh, list[int]], Float[Tensor, " B"]]


def passes_at_once(device: torch.device) -> int:
    """How many passes may run at the same time: a thread of torch for each; one on a GPU, which a pass uses better."""
    return min(torch.get_num_threads(), MAX_PASSES_AT_ONCE) if device.type == "cpu" else 1


def one_at_a_time(iou: Iou) -> Iou:
    """The same for several threads: it calls the geometry renderer, a plugin, by one of them at a time.

    The gradients of its results are not locked; `GeometryRenderer.overlap` says so.
    """
    lock = threading.Lock()

    def locked(mesh: Mesh, views: list[int]) -> Float[Tensor, " B"]:
        with lock:
            return iou(mesh, views)

    return locked


def run_passes(passes: Sequence[Callable[[StageContext], T]], context: StageContext, at_once: int) -> list[T]:
    """The results of passes, each of which gets a context, in their order; at most `at_once` run at the same time.

    Observers receive the steps of the first pass as they are done, and those of the others after it, as if the passes
    ran one after the other.
    """
    if min(at_once, len(passes)) <= 1:
        return [fit(context) for fit in passes]
    signal, lock = StopSignal(), threading.Lock()
    waiting: list[list[Progress]] = [[] for _ in passes]

    def report(number: int, progress: Progress) -> None:
        signal.check()
        if number == 0:
            context.report(progress)
        else:
            waiting[number].append(progress)

    def warn(sentence: str) -> None:
        with lock:
            context.warn(sentence)

    own = [replace(context, report=partial(report, number), warn=warn) for number in range(len(passes))]
    results = run_in_parallel([partial(fit, each) for fit, each in zip(passes, own, strict=True)], at_once, signal)
    for progress in (each for queue in waiting for each in queue):
        context.report(progress)
    return results
