"""Fits the outlines alone: a bending energy, or photographs of a surface without texture, moved them off the masks.

Without a bending energy outlines also follow the noise of masks. So views that take no part judge how far they go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hir_core.scene import Mesh
from hir_core.stages.geometry.confirmed_movement import (
    ConfirmedShare,
    HeldOutEvaluation,
    HeldOutIou,
    confirmed_movement,
    interpolated,
)
from hir_core.stages.geometry.silhouettes.silhouette_fit import SilhouetteFit, SilhouettePass, fit_mesh

LEARNING_RATE, LEARNING_RATE_END = 5e-3, 0.05
"""The first as a fraction of the object's radius: outlines are less than a pixel off."""

SMOOTHNESS = 2.0
"""LargeSteps' λ; nothing else smooths the movement."""

LINE = (0.0, 0.5, 1.0)
"""Shares of the way between the two meshes at which the judging views are evaluated."""

LEAST_GAIN = 0.005
"""Relative fall of the error of judging views of which half is believed, even where they agree."""


@dataclass(frozen=True)
class OutlinesSkipped:
    """The outlines were left as they are, and why."""

    reason: str
    accepted: bool = False


@dataclass(frozen=True)
class OutlinesReport:
    """One refinement of the outlines, against the mesh that it started from."""

    accepted: bool
    """Some part of the movement is confirmed."""
    judging_views: list[str]
    """Names of the views that took no part in it and decided."""
    movement: ConfirmedShare
    """From the initial mesh towards the refined one; the error is 1 − IoU."""
    judging_iou: HeldOutIou
    """Mean IoU of the judging views."""
    skipped_steps: dict[str, int]
    """Steps without a finite gradient, by the term that caused it."""


def refine_outlines(mesh: Mesh, fit: SilhouetteFit, number: int) -> tuple[Mesh, OutlinesReport | OutlinesSkipped]:
    """The mesh with its outlines moved towards the masks as far as judging views confirm it, and the report; the mesh
    as it is and the reason where the settings leave it out or no view judges.

    `number` counts the refinements of a stage.
    """
    steps = fit.settings.outline_iterations
    if steps == 0:
        return mesh, OutlinesSkipped("left out by the settings")
    if not fit.judges:
        return mesh, OutlinesSkipped("too few views that could be held out")
    plan = SilhouettePass(
        name=f"outlines_{number}",
        number=number,
        train=[i for i in fit.train if i not in set(fit.judges)],
        held_out=(),
        first_step=0,
        steps=steps,
        total_steps=steps,
        learning_rate=LEARNING_RATE,
        learning_rate_end=LEARNING_RATE_END,
        smoothness=SMOOTHNESS,
        regularizers={},
        trust_errors_from=0,
    )
    fitted, loop, _ = fit_mesh(mesh, fit, plan)

    def evaluated(candidate: Mesh) -> HeldOutEvaluation:
        errors = np.array(list(fit.errors(candidate, fit.judges).values()))
        return HeldOutEvaluation(errors, 1 - float(errors.mean()))

    movement, (before, after) = confirmed_movement(mesh, fitted, evaluated, LINE, LEAST_GAIN)
    report = OutlinesReport(
        accepted=movement.share > 0,
        judging_views=[fit.names[i] for i in fit.judges],
        movement=movement.rounded(),
        judging_iou=HeldOutIou(round(before, 5), round(after, 5)),
        skipped_steps=loop.skipped,
    )
    return interpolated(mesh, fitted, movement.share), report
