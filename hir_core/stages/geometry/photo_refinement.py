"""Moves the vertices until the photographs agree about the surface; silhouettes hold the outline meanwhile.

Outlines say nothing about hollows. Once the silhouettes fit, points of the surface are compared between neighbouring
views (`photo_consistency`), from coarse photographs to fine ones, and the vertices follow the gradient. From the mesh
of the coarsest level that is tried twice, smoothly and carving finely; views that took no part choose, and the result
stays only where they agree better with it than with the mesh it started from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GeometrySettings
from hir_core.mesh.large_steps import LargeSteps, UniformAdam
from hir_core.optimization.nonfinite_diagnostics import views_at_fault
from hir_core.optimization.optimization_loop import Batches, Keep, Schedule, Terms, optimize, tell_troubles
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.photo_consistency import (
    Details,
    disagreement,
    draw_pairs,
    finest_downsample,
    neighbours,
)

COARSEST = 4
"""The first level sees photographs at this fraction of the finest resolution that is used."""
SMALLEST_SIDE = 48
"""Pixels below which a photograph has no detail left to compare."""
PIXELS_A_VIEW = 4000
HUBER = 0.5
"""In units of local contrast: what differs by more is another thing, an occluder or a highlight."""
SILHOUETTE_WEIGHT = 3.0
SMOOTHNESS = 20.0
"""LargeSteps' λ, and all that smooths here: photographs speak about every facet, and a bending energy of the weight
that outlines need keeps the hollows shut (chair: disagreement −7 % with it, −32 % without)."""
FINE_SMOOTHNESS = 2.0
"""λ of the second attempt, for carvings that are as fine as the mesh; below it facets fold."""
RATE = 1e-2
"""Step size as a fraction of the object's radius, at the finest level; coarser ones stride by the root of theirs."""
JUDGED_PIXELS = 2000
SIGNIFICANCE = 1.0
"""Standard errors that the gain must exceed: no term is added to the model, the better mesh of two is chosen."""
LEAST_GAIN = 0.005
"""Share by which the disagreement must fall in views that took no part."""
FINE_GAIN = 0.03
"""Share by which the second attempt must be better than the first, and by a standard error, too. Where there is
nothing to carve it roughens the normals, which photographs compared with each other do not see and highlights do
(spot: disagreement −1 %, unseen views −0.5 dB)."""
LEAST_DETAIL = 1e-4
"""Disagreement below which there is nothing to lower: photographs without detail agree about every surface."""
MOST_IOU_LOST = 0.002


@dataclass(frozen=True)
class Judgement:
    """Disagreement of views that took no part, and how well silhouettes fit them."""

    disagreement: NDArray[np.float64]
    iou: float


def refine_by_photographs(
    mesh: Mesh,
    capture: Capture,
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    held_out: Sequence[int],
    settings: GeometrySettings,
    context: StageContext,
) -> tuple[Mesh, dict[str, Any]]:
    """The mesh whose surface the photographs agree about, or the one given, and what was measured.

    `capture` has the object centred and of radius about 1; `iou(mesh, views)` is differentiable. Views `held_out` take
    no part and decide. Without them, or without overlapping views, the mesh is returned as it is and the report says
    why.
    """
    views = capture.views
    train = [i for i in range(len(views)) if i not in set(held_out)]
    near = neighbours(capture.cameras, train)
    judges = [i for i in held_out if near[i]]
    if not judges or not any(near[i] for i in train):
        return mesh, {"kept": False, "reason": "too few views that overlap and could be held out"}
    finest = finest_downsample(views, settings.downsample)
    factors = [finest * f for f in _powers(COARSEST) if _side(capture) >= SMALLEST_SIDE * finest * f or f == 1]
    details = Details.of(views, factors[-1])
    before = _judge(mesh, details, near, judges, iou, context.seed)
    if not np.nanmax(before.disagreement, initial=0.0) > LEAST_DETAIL:
        return mesh, {"kept": False, "reason": "the photographs show no detail to compare"}
    attempts = dict.fromkeys((SMOOTHNESS, FINE_SMOOTHNESS), mesh)
    levels = []
    for downsample, passes in groupby(_passes(factors), key=lambda place: place.downsample):
        seen = details if downsample == factors[-1] else Details.of(views, downsample)
        for place in passes:
            begun = attempts[place.smoothness]
            found, curve = _fit_pass(begun, seen, near, train, iou, settings, context, place)
            attempts |= dict.fromkeys(attempts if place.shared else [place.smoothness], found)
            ends = [round(float(v), 5) for v in _ends(curve)]
            levels.append(
                {"smoothness": place.smoothness, "downsample": downsample, "shared": place.shared, "disagreement": ends}
            )
    after, fine = (_judge(found, details, near, judges, iou, context.seed) for found in attempts.values())
    fine_gain, fine_noise = _gain(after.disagreement, fine.disagreement)
    carved = fine_gain > max(SIGNIFICANCE * fine_noise, FINE_GAIN) and fine.iou > after.iou - MOST_IOU_LOST
    refined = attempts[FINE_SMOOTHNESS if carved else SMOOTHNESS]
    after = fine if carved else after
    gain, noise = _gain(before.disagreement, after.disagreement)
    kept = gain > max(SIGNIFICANCE * noise, LEAST_GAIN) and after.iou > before.iou - MOST_IOU_LOST
    report = {
        "kept": kept,
        "levels": levels,
        "fine": {"kept": kept and carved, "gain": round(fine_gain, 5), "noise": round(fine_noise, 5)},
        "held_out_gain": round(gain, 5),
        "noise": round(noise, 5),
        "held_out_disagreement": {
            "before": _mean(before.disagreement),
            "after": _mean(after.disagreement),
        },
        "held_out_iou": {"before": round(before.iou, 5), "after": round(after.iou, 5)},
    }
    return (refined if kept else mesh), report


@dataclass(frozen=True)
class _Pass:
    """One of several optimisations, one after the other."""

    number: int
    count: int
    downsample: int
    coarseness: float
    """Its pixels' size, in those of the finest."""
    smoothness: float
    shared: bool
    """The coarsest of several levels: both attempts go on from its mesh."""


def _passes(factors: Sequence[int]) -> list[_Pass]:
    """In turn, each level's passes beside each other, so that its photographs are read once."""
    coarsest, *finer = factors
    shared = [(coarsest, SMOOTHNESS)] if finer else []
    apart = [(factor, smoothness) for factor in finer or factors for smoothness in (SMOOTHNESS, FINE_SMOOTHNESS)]
    course = shared + apart
    return [
        _Pass(number, len(course), factor, factor / factors[-1], smoothness, number < len(shared))
        for number, (factor, smoothness) in enumerate(course)
    ]


def _fit_pass(
    mesh: Mesh,
    details: Details,
    near: Sequence[Sequence[int]],
    train: Sequence[int],
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    settings: GeometrySettings,
    context: StageContext,
    place: _Pass,
) -> tuple[Mesh, NDArray[np.float64]]:
    large = LargeSteps(mesh.topology, len(mesh.positions), place.smoothness)
    unknown = large.encode(mesh.positions.detach()).requires_grad_(True)
    rate = RATE * place.coarseness**0.5
    seed = context.seed + 100 * (place.number + 1)
    shown = Batches(len(train), settings.views_per_step, seed)
    outlined = Batches(len(train), max(1, settings.views_per_step // 2), seed + 1)
    steps = settings.photograph_iterations
    checkpoint = context.checkpoints / f"photographs_{place.downsample}_{place.smoothness:g}.npz"

    def loss(step: int) -> Terms:
        current = mesh.with_positions(large.decode(unknown))
        generator = np.random.default_rng((seed, step))
        pairs = draw_pairs(details, near, [train[i] for i in shown(step)], PIXELS_A_VIEW, generator)
        difference, _ = disagreement(current, details, pairs)
        outline = iou(current, [train[i] for i in outlined(step)])
        return {
            "photographs": _huber(difference).mean() if len(difference) else 0.0 * unknown.sum(),
            "silhouette": SILHOUETTE_WEIGHT * (1 - outline).mean().to(unknown),
        }

    def locate(step: int, term: str) -> str:
        current = mesh.with_positions(large.decode(unknown).detach())
        if term == "silhouette":
            views = [train[i] for i in outlined(step)]
            return views_at_fault(current, views, details.names, lambda moved, view: 1 - iou(moved, [view]))

        def compared(moved: Mesh, view: int) -> Tensor:
            pairs = draw_pairs(details, near, [view], PIXELS_A_VIEW, np.random.default_rng((seed, step)))
            difference, _ = disagreement(moved, details, pairs)
            return _huber(difference).mean() if len(difference) else 0.0 * moved.positions.sum()

        return views_at_fault(current, [train[i] for i in shown(step)], details.names, compared)

    report = optimize(
        loss,
        UniformAdam([unknown], rate),
        Schedule(steps, end=0.05),
        stage="geometry",
        report=lambda progress: context.report(replace(progress, message="photographs")),
        keep=Keep(checkpoint, context.checkpoint_seconds),
        locate=locate,
        first_step=place.number * steps,
        total_steps=place.count * steps,
    )
    tell_troubles(report, context.warn)
    with torch.no_grad():
        return mesh.with_positions(large.decode(unknown).detach()), report.curves.get("photographs", np.zeros(0))


def _judge(
    mesh: Mesh,
    details: Details,
    near: Sequence[Sequence[int]],
    judges: list[int],
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    seed: int,
) -> Judgement:
    """The same pixels whatever the mesh; a pair that the mesh hides from a view says nothing."""
    errors = []
    with torch.no_grad():
        for view in judges:
            pairs = draw_pairs(details, near, [view], JUDGED_PIXELS, np.random.default_rng((seed, view)))
            difference, _ = disagreement(mesh, details, pairs)
            errors.append(float(_huber(difference).mean()) if len(difference) else np.nan)
        silhouettes = float(iou(mesh, judges).mean())
    return Judgement(np.array(errors), silhouettes)


def _gain(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float]:
    """Mean relative fall of the disagreement and its standard error; nothing gained where nothing can be compared."""
    known = np.isfinite(before) & np.isfinite(after) & (before > 0)
    if known.sum() < 2:
        return 0.0, 0.0
    gains = 1 - after[known] / before[known]
    return float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(known.sum()))


def _mean(errors: NDArray[np.float64]) -> float | None:
    """Over the views that could compare something; None where none could."""
    known = errors[np.isfinite(errors)]
    return round(float(known.mean()), 5) if len(known) else None


def _huber(difference: Tensor) -> Tensor:
    return torch.nn.functional.huber_loss(difference, torch.zeros_like(difference), delta=HUBER, reduction="none")


def _powers(largest: int) -> list[int]:
    return [largest] + (_powers(largest // 2) if largest > 1 else [])


def _side(capture: Capture) -> int:
    return min(min(camera.width, camera.height) for camera in capture.cameras)


def _ends(curve: NDArray[np.float64]) -> list[float]:
    """Mean of the first and of the last tenth."""
    part = max(1, len(curve) // 10)
    return [float(np.mean(curve[:part])), float(np.mean(curve[-part:]))] if len(curve) else []
