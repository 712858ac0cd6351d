"""One progress bar over the phases of a solver's fit, with the milestones of its model selection."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, final

import numpy as np

from hir_core.plugins.progress import MODEL_FITTED, MODELS_COMPARED, Progress
from hir_core.stages.reflectance.selection.model_selection import SelectionObserver
from hir_core.stages.reflectance.selection.refinement_selection import Comparison

if TYPE_CHECKING:
    from hir_core.run.stage_context import StageContext

PROGRESS_STEPS = 1000
"""Steps of the bar: a solver reports shares, not steps."""
PHASES = {"model selection": 0.6, "all views": 0.2, "textures": 0.08, "path tracing": 0.12}
"""Shares of the bar. On the sample capture they took .62, .28, .03 and .07 of the time; a per-texel BRDF, which other
captures have, takes more for its textures."""


@final
class StageProgress(SelectionObserver):
    """Turns the share that each phase has done into the progress of the stage."""

    def __init__(self, context: StageContext) -> None:
        self._context = context
        self._began = time.perf_counter()
        self._done = 0.0
        self._name = ""

    def phase(self, phase: str, name: str = "") -> Callable[[float], None]:
        """The function that receives the share of a phase of `PHASES`; `name` is shown beside the bar."""
        before = list(PHASES)[: list(PHASES).index(phase)]
        begin, width = sum(PHASES[other] for other in before), PHASES[phase]
        return lambda share: self._advance(name or phase, begin + width * share)

    def selecting(self, model: str, share: float) -> None:
        """A model is being fitted, with this share of the model selection done."""
        self.phase("model selection", model)(share)

    def evaluated(self, held_out_db: float) -> None:
        """Mean PSNR of a fit."""
        self._report({"held_out_psnr": np.array([held_out_db])}, MODEL_FITTED)

    def compared(self, comparison: Comparison) -> None:
        """A candidate was compared; all that was fitted for it has finished."""
        self._report({}, MODELS_COMPARED)

    def _advance(self, name: str, done: float) -> None:
        self._name, self._done = name, max(self._done, done)
        self._report({})

    def _report(self, scalars: dict[str, np.ndarray], milestone: str = "") -> None:
        step = min(PROGRESS_STEPS, max(1, round(self._done * PROGRESS_STEPS)))
        seconds = time.perf_counter() - self._began
        progress = Progress("reflectance", step, PROGRESS_STEPS, seconds, scalars, self._name, milestone=milestone)
        self._context.report(progress)
