"""The optimisations of the photo-consistency refinement: which there are, and how one runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.config import GeometrySettings
from hir_core.mesh.large_steps import LargeSteps, UniformAdam
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.optimization.nonfinite_diagnostics import nonfinite_views
from hir_core.optimization.optimization_loop import Checkpointing, optimize, warn_of_skipped_steps
from hir_core.optimization.optimization_report import Terms
from hir_core.optimization.parallel_jobs import one_thread
from hir_core.optimization.schedules import Batches, Schedule
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.photo_consistency.detail_images import DetailImages
from hir_core.stages.geometry.photo_consistency.photo_error import huber
from hir_core.stages.geometry.photo_consistency.photo_residuals import (
    photo_consistency_residuals,
    ray_structure,
    sample_pairs,
)

PIXELS_PER_VIEW = 4000
"""Of a step."""

SILHOUETTE_WEIGHT = 3.0

SMOOTHNESS = 20.0
"""LargeSteps' λ of the smooth candidate, and the only smoothing: photo-consistency constrains every facet, and a
bending energy of the weight that silhouettes need keeps hollows closed (chair: error −7 % with it, −32 % without)."""

FINE_SMOOTHNESS = 2.0
"""LargeSteps' λ of the fine candidate, for carvings as fine as the mesh; with less smoothing facets fold."""

LEARNING_RATE = 1e-2
"""Step size as a fraction of the object's radius, at the finest level; that of a coarser level is larger by the root of
its coarseness."""

FINAL_LEARNING_RATE = 0.05
"""Factor of the learning rate at the end of a pass."""

STEPS_PER_RAY_STRUCTURE = 4
"""The acceleration structure of the mesh, which takes a quarter of a step, is built once for this many. Five meshes had
nearly the errors that they have with one for each step (docs/studies/photo_consistency.md)."""

LAST_PASS_SHARE = 0.5
"""Steps of the pass with all views, as a share of another pass: it starts from a mesh that most of them have fitted."""


@dataclass(frozen=True)
class Pass:
    """One of several optimisations that run one after the other."""

    number: int
    first_step: int
    steps: int
    downsample: int
    coarseness: float
    """Width of its pixels, in pixels of the finest level."""
    smoothness: float
    shared: bool
    """The coarsest of several levels: both candidates continue from its mesh."""

    @property
    def end(self) -> int:
        """The step after the last, counted over all passes."""
        return self.first_step + self.steps


def plan_passes(factors: Sequence[int], steps: int) -> tuple[list[Pass], Pass]:
    """The passes of `steps` steps each for downsampling `factors`, coarse to fine, and the last one, which takes in the
    judging views too.

    Passes of one resolution follow each other, so that its photographs are read once.
    """
    coarsest, *finer = factors
    shared = [(coarsest, SMOOTHNESS)] if finer else []
    separate = [(factor, smoothness) for factor in finer or factors for smoothness in (SMOOTHNESS, FINE_SMOOTHNESS)]
    order = shared + separate
    passes = [
        Pass(number, number * steps, steps, factor, factor / factors[-1], smoothness, number < len(shared))
        for number, (factor, smoothness) in enumerate(order)
    ]
    last_steps = round(LAST_PASS_SHARE * steps)
    return passes, Pass(len(order), passes[-1].end, last_steps, factors[-1], 1.0, SMOOTHNESS, False)


@one_thread()
def fit_pass(
    mesh: Mesh,
    details: DetailImages,
    neighbours: Sequence[Sequence[int]],
    train: Sequence[int],
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    settings: GeometrySettings,
    context: StageContext,
    *,
    plan: Pass,
    total_steps: int,
    large: LargeSteps,
) -> tuple[Mesh, NDArray[np.floating]]:
    """The mesh after one optimisation, and its photo-consistency error at each step. `large`: of the mesh
    and the plan's smoothness."""
    parameter = large.encode(mesh.positions.detach()).requires_grad_(True)
    rate = LEARNING_RATE * plan.coarseness**0.5
    seed = context.seed + 100 * (plan.number + 1)
    photo_batches = Batches(len(train), settings.views_per_step, seed)
    silhouette_batches = Batches(len(train), max(1, settings.views_per_step // 2), seed + 1)
    checkpoint = context.checkpoints / f"photo_consistency_{plan.number}_{plan.downsample}_{plan.smoothness:g}.npz"

    tracer: MeshQueries | None = None

    def photo_error(moved: Mesh, views: list[int], step: int) -> Tensor:
        pairs = sample_pairs(details, neighbours, views, PIXELS_PER_VIEW, np.random.default_rng((seed, step)))
        residuals, _ = photo_consistency_residuals(moved, details, pairs, tracer)
        return huber(residuals).mean() if len(residuals) else 0.0 * moved.positions.sum()

    def loss(step: int) -> Terms:
        nonlocal tracer
        current = mesh.with_positions(large.decode(parameter))
        if step % STEPS_PER_RAY_STRUCTURE == 0:
            tracer = ray_structure(current)
        error = photo_error(current, [train[i] for i in photo_batches(step)], step)
        silhouettes = iou(current, [train[i] for i in silhouette_batches(step)])
        silhouette_error = SILHOUETTE_WEIGHT * (1 - silhouettes).mean().to(parameter)
        return {"photo_consistency": error, "silhouette": silhouette_error}

    def locate(step: int, term: str) -> str:
        current = mesh.with_positions(large.decode(parameter).detach())
        if term == "silhouette":
            views = [train[i] for i in silhouette_batches(step)]
            return nonfinite_views(current, views, details.names, lambda moved, view: 1 - iou(moved, [view]))
        views = [train[i] for i in photo_batches(step)]
        return nonfinite_views(current, views, details.names, lambda moved, view: photo_error(moved, [view], step))

    report = optimize(
        loss,
        UniformAdam([parameter], rate),
        Schedule(plan.steps, end=FINAL_LEARNING_RATE),
        stage="geometry",
        report=lambda progress: context.report(replace(progress, message="photo-consistency")),
        checkpointing=Checkpointing(checkpoint, context.checkpoint_seconds, STEPS_PER_RAY_STRUCTURE),
        locate=locate,
        first_step=plan.first_step,
        total_steps=total_steps,
    )
    warn_of_skipped_steps(report, context.warn)
    with torch.no_grad():
        curve = report.curves.get("photo_consistency", np.zeros(0))
        return mesh.with_positions(large.decode(parameter).detach()), curve
