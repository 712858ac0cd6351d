"""Fits one mesh of fixed topology to the masks; held-out views choose the result and end the level.

Fewer than `MIN_HELD_OUT_VIEWS` choose nothing: the level takes all its steps, and its last state is the result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.config import GeometrySettings
from hir_core.mesh.large_steps import LargeSteps, UniformAdam
from hir_core.optimization.checkpoints import CombinedState
from hir_core.optimization.nonfinite_diagnostics import nonfinite_vertices, nonfinite_views
from hir_core.optimization.optimization_loop import Checkpointing, optimize, sum_of, warn_of_skipped_steps
from hir_core.optimization.optimization_report import OptimizationReport, Terms
from hir_core.optimization.parallel_jobs import one_thread
from hir_core.optimization.schedules import Batches, Schedule
from hir_core.optimization.weighted_energies import prepare_energies
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene
from hir_core.scene.silhouette_targets import SilhouetteTargets, intersection_over_union
from hir_core.stages.geometry.measured_depths.depth_term import DepthRays
from hir_core.stages.geometry.silhouettes.best_state import BestState
from hir_core.stages.geometry.silhouettes.robust_view_weights import RobustViewWeights
from hir_core.stages.held_out_views import MIN_HELD_OUT_VIEWS

HELD_OUT_INTERVAL_STEPS = 25
"""Held-out views are evaluated this often."""

EARLIEST_STOP = 0.7
"""Share of a level's steps before which it does not end: at the full learning rate the error only oscillates."""

VIEWS_PER_BATCH = 8
"""Of evaluations without gradient."""


@dataclass
class SilhouetteFit:
    """What all levels of the fit share."""

    renderer: GeometryRenderer
    targets: SilhouetteTargets
    settings: GeometrySettings
    context: StageContext
    held_out: list[int]
    judges: list[int]
    """Views that decide how far outlines move; those held out are among them."""
    names: list[str]
    """Of all views, for messages."""
    depth: DepthRays | None = None
    """Measured depths of the views that take part in the fit."""

    def __post_init__(self) -> None:
        self.areas = self.targets.areas
        self.train = [i for i in range(len(self.targets)) if i not in set(self.held_out)]
        self.view_weights = RobustViewWeights(len(self.targets))

    def iou(self, mesh: Mesh, views: list[int]) -> Float[Tensor, " B"]:
        """IoU of each of the named views; differentiable."""
        area, intersection = self.renderer.overlap(mesh, self.targets[views])
        return intersection_over_union(area, intersection, self.areas[views].to(area.device))

    def errors(self, mesh: Mesh, views: Sequence[int]) -> dict[int, float]:
        """1 − IoU of each of the named views."""
        errors: dict[int, float] = {}
        with torch.no_grad():
            for i in range(0, len(views), VIEWS_PER_BATCH):
                batch = list(views[i : i + VIEWS_PER_BATCH])
                errors.update(zip(batch, (1 - self.iou(mesh, batch)).tolist(), strict=True))
        return errors


@dataclass(frozen=True)
class SilhouettePass:
    """One optimisation of a mesh of fixed topology."""

    name: str
    """Of its checkpoint."""
    number: int
    """It changes the random batches of views."""
    train: Sequence[int]
    held_out: Sequence[int]
    """Views that choose the state, if they are enough."""
    first_step: int
    steps: int
    total_steps: int
    """Of all passes that count their steps together."""
    learning_rate: float
    """As a fraction of the object's radius."""
    learning_rate_end: float
    smoothness: float | None
    """LargeSteps' λ; None moves the vertices themselves."""
    regularizers: Mapping[str, dict[str, Any] | Literal[False]]
    trust_errors_from: int
    """Views whose masks contradict the others lose weight from this step on."""


def pass_of_level(fit: SilhouetteFit, level: int, levels: int) -> SilhouettePass:
    """The pass of one of several resolutions."""
    settings = fit.settings
    steps = settings.iterations_per_view * len(fit.train) if settings.iterations_per_view else settings.iterations
    return SilhouettePass(
        name=f"level_{level}",
        number=level,
        train=fit.train,
        held_out=fit.held_out,
        first_step=level * steps,
        steps=steps,
        total_steps=levels * steps,
        learning_rate=settings.learning_rate,
        learning_rate_end=settings.learning_rate_end,
        smoothness=settings.smoothness if settings.parameterization == "large_steps" else None,
        regularizers=settings.regularizers,
        # early in a fit a large error means that the mesh is wrong, not the mask
        trust_errors_from=0 if level > 0 else steps // 2 + 1,
    )


@one_thread()
def fit_mesh(mesh: Mesh, fit: SilhouetteFit, plan: SilhouettePass) -> tuple[Mesh, OptimizationReport, float | None]:
    """The mesh of the lowest held-out error (the last one with too few views), the report, and that error."""
    settings, context = fit.settings, fit.context
    scene = Scene(mesh)
    energies = prepare_energies(scene, plan.regularizers, context.plugins, context.seed)
    batches = Batches(len(plan.train), max(1, settings.views_per_step), context.seed + plan.number)
    radius = settings.start_radius or 1.0
    rate = plan.learning_rate * radius
    optimizer: torch.optim.Optimizer
    if plan.smoothness is not None:
        large = LargeSteps(mesh.topology, len(mesh.positions), plan.smoothness)
        parameter = large.encode(mesh.positions.detach()).requires_grad_(True)
        decode: Callable[[Tensor], Tensor] = large.decode
        optimizer = UniformAdam([parameter], rate)
    else:
        parameter = mesh.positions.detach().clone().requires_grad_(True)
        decode = lambda positions: positions  # noqa: E731
        optimizer = torch.optim.Adam([parameter], rate)

    def loss(step: int) -> Terms:
        current = mesh.with_positions(decode(parameter))
        views = [plan.train[i] for i in batches(step)]
        error = 1 - fit.iou(current, views)
        weight = torch.ones_like(error)
        if settings.robust:
            active = step >= plan.trust_errors_from
            weights = fit.view_weights.update(views, error.detach().cpu().numpy(), active)
            weight = torch.as_tensor(weights, dtype=error.dtype, device=error.device)
        terms = {"silhouette": (weight * error).sum() / len(views)} | energies(replace(scene, mesh=current))
        if fit.depth is None:
            return terms
        return terms | {"depth": settings.depth_weight / radius**2 * fit.depth.energy(current, step)}

    best = BestState(parameter)
    views_choose = len(plan.held_out) >= MIN_HELD_OUT_VIEWS

    def held_out_error() -> float:
        with torch.no_grad():
            errors = fit.errors(mesh.with_positions(decode(parameter)), plan.held_out)
        return float(np.median(list(errors.values())))

    def locate(step: int, term: str) -> str:
        current = mesh.with_positions(decode(parameter).detach())
        if term == "silhouette":
            views = [plan.train[i] for i in batches(step)]
            return nonfinite_views(current, views, fit.names, lambda moved, view: 1 - fit.iou(moved, [view]))
        return nonfinite_vertices(current, lambda moved: sum_of(energies(replace(scene, mesh=moved))))

    def after_step(step: int) -> bool:
        if not plan.held_out or (step + 1) % HELD_OUT_INTERVAL_STEPS:
            return False
        error = held_out_error()
        done = plan.first_step + step + 1
        context.report(Progress("geometry", done, plan.total_steps, 0.0, {"held_out": np.array([error])}))
        return views_choose and best.update(parameter, error) and step > EARLIEST_STOP * plan.steps

    report = optimize(
        loss,
        optimizer,
        Schedule(plan.steps, end=plan.learning_rate_end),
        stage="geometry",
        report=context.report,
        after_step=after_step,
        checkpointing=Checkpointing(context.checkpoints / f"{plan.name}.npz", context.checkpoint_seconds),
        extra_state=CombinedState(best=best, view_weights=fit.view_weights),
        locate=locate,
        first_step=plan.first_step,
        total_steps=plan.total_steps,
    )
    warn_of_skipped_steps(report, context.warn)
    error = best.error
    if error is None and plan.held_out:
        error = held_out_error()
    with torch.no_grad():
        chosen = parameter if best.error is None else best.tensor
        return mesh.with_positions(decode(chosen).detach()), report, error
