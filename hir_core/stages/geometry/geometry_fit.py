"""The geometry stage: moves a mesh until its silhouettes are the masks, then until the photographs agree about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Camera, Capture
from hir_core.config import GeometrySettings
from hir_core.errors import StageError
from hir_core.mesh.attribute_transfer import remeshed
from hir_core.mesh.large_steps import LargeSteps, UniformAdam
from hir_core.mesh.mesh_validity import MeshState, inspect_mesh
from hir_core.mesh.remeshing import surface_area
from hir_core.mesh.self_intersection_repair import separate, untangle
from hir_core.optimization.checkpoints import Arrays, Together
from hir_core.optimization.nonfinite_diagnostics import vertices_at_fault, views_at_fault
from hir_core.optimization.optimization_loop import (
    Batches,
    Keep,
    OptimizationReport,
    Schedule,
    Terms,
    optimize,
    sum_of,
    tell_troubles,
)
from hir_core.optimization.weighted_energies import prepare_energies
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene
from hir_core.scene.frames import unit_similarity
from hir_core.scene.silhouette_targets import SilhouetteTargets, intersection_over_union
from hir_core.stages.geometry.floating_components import without_loose_pieces
from hir_core.stages.geometry.photo_refinement import refine_by_photographs
from hir_core.stages.geometry.robust_view_weights import ViewTrust
from hir_core.stages.geometry.silhouette_residual import NOTABLE, Residue, mask_residue

EDGE_PIXELS = 4.0
"""Edges of the final mesh, in pixels: a circle of 50 pixels radius is then off by 0.04 pixels."""

TRIANGLES_MIN, TRIANGLES_MAX = 8_000, 400_000
"""Many small photographs tell more than one of them: a cow in 80 of 128² lost its ears and horns at 1,800 triangles
(IoU 0.952 on held-out views; 0.970 at 6,000, 0.971 at 20,000)."""

WORSE = 0.005
"""Loss of IoU on held-out views, start to end, that is said aloud."""

NEAR_START = 0.1
"""Below this median error (1 − IoU) a start counts as near."""

CHECK_STEPS = 25
"""Held-out views are measured this often."""

SETTLED = 0.7
"""Share of a level's steps before which it does not end."""

PATIENCE_CHECKS = 6
"""A level ends when this many measurements in a row brought nothing."""


def fit_geometry(
    scene: Scene, capture: Capture, settings: GeometrySettings, context: StageContext
) -> tuple[Scene, dict[str, Any]]:
    """The scene with its mesh fitted to the masks of the capture's views, and what happened on the way.

    The world is moved so that the start mesh is centred and of radius 1 (or `start_radius`) while the stage runs, in
    float64, and moved back at the end. A start without triangles, or views without masks or cameras, are errors.
    """
    frame = _working_similarity(scene.mesh, settings.start_radius)
    mesh = replace(scene.mesh, positions=_moved(scene.mesh.positions, frame))
    capture = capture.transformed(frame)
    options = context.options.get("geometry_renderer", {}).get(settings.renderer, {})
    renderer: GeometryRenderer = context.plugins.create("geometry_renderer", settings.renderer, options)
    targets = renderer.prepare(capture.views, settings.downsample).to(mesh.positions.device)
    if len(targets) == 0:
        raise StageError("the geometry stage was given no views; name a capture with photographs")
    names = [view.name for view in capture.views]
    fit = _Fit(renderer, targets, settings, context, _hold_out(len(targets), settings.held_out), names)
    before = inspect_mesh(*_arrays(mesh))
    first = fit.errors(mesh, list(range(len(targets))))
    loose = 0
    if settings.prune:
        mesh, loose = without_loose_pieces(renderer, mesh, targets, fit.train)
    reports: list[dict[str, Any]] = []
    curves: list[np.ndarray] = []
    levels = _level_count(settings, float(np.median(list(first.values()))))
    for level in range(levels):
        if settings.remesh:
            # of the surface as it is by now: a ball around a cow has twice the cow's area
            mesh = remeshed(mesh, max(500, _triangles(mesh, targets, settings) // 4 ** (levels - 1 - level)))
        mesh, loop, held = _fit_level(mesh, fit, level, levels)
        curves.append(loop.curves.get("silhouette", np.zeros(0)))
        reports.append(
            {
                "triangles": len(mesh.faces),
                "steps": loop.steps,
                "held_out_error": held,
                "stopped_early": loop.stopped_early,
                "skipped_steps": loop.skipped,
            }
        )
    outlined = mesh
    photographs: dict[str, Any] = {"kept": False, "reason": "left out by the settings"}
    if settings.photographs == "auto":
        mesh, photographs = refine_by_photographs(mesh, capture, fit.iou, fit.held, settings, context)
    after = inspect_mesh(*_arrays(mesh))
    if after.self_intersecting > before.self_intersecting:
        positions, faces = _arrays(mesh)
        # sheets that graze are pushed apart; where photographs folded the surface, it goes back to what the outlines
        # said; what they folded is smoothed
        positions = separate(positions, faces, before.self_intersecting)
        if photographs["kept"]:
            positions = untangle(positions, faces, before.self_intersecting, toward=_arrays(outlined)[0])
        mended = untangle(positions, faces, before.self_intersecting)
        mesh = mesh.with_positions(torch.from_numpy(mended).to(mesh.positions))
        after = inspect_mesh(*_arrays(mesh))
    last = fit.errors(mesh, list(range(len(targets))))
    train = fit.train
    residue = mask_residue(renderer, mesh, targets, [i for i in train if i not in fit.trust.distrusted()])
    _advise(replace(before, components=before.components - loose), after, residue, fit, names, context)
    held_out = {"before": _mean_iou(first, fit.held), "after": _mean_iou(last, fit.held)}
    _advise_outlines(held_out, context)
    report = {
        "iou_train": {"before": _mean_iou(first, train), "after": _mean_iou(last, train)},
        "iou_held_out": held_out,
        "views": {
            "train": len(train),
            "held_out": [names[i] for i in fit.held],
            "down_weighted": {names[i]: round(float(w), 4) for i, w in fit.trust.distrusted().items()},
        },
        "loose_pieces_removed": loose,
        "residue": {"missing": residue.missing, "filled": residue.filled},
        "mesh": {"before": before.as_dict(), "after": after.as_dict()},
        "levels": reports,
        "photographs": photographs,
        "curves": {"silhouette": np.concatenate(curves).tolist() if curves else []},
    }
    moved = replace(mesh, positions=_moved(mesh.positions.detach(), np.linalg.inv(frame)))
    return replace(scene, mesh=moved), report


@dataclass
class _Fit:
    """What all levels share."""

    renderer: GeometryRenderer
    targets: SilhouetteTargets
    settings: GeometrySettings
    context: StageContext
    held: list[int]
    names: list[str]
    """Of the views, for whoever is told of them."""

    def __post_init__(self) -> None:
        self.areas = self.targets.areas
        self.train = [i for i in range(len(self.targets)) if i not in set(self.held)]
        self.trust = ViewTrust(len(self.targets))

    def iou(self, mesh: Mesh, views: list[int]) -> Float[Tensor, " B"]:
        """IoU of each of the views named; differentiable."""
        area, intersection = self.renderer.overlap(mesh, self.targets[views])
        return intersection_over_union(area, intersection, self.areas[views].to(area.device))

    def errors(self, mesh: Mesh, views: list[int]) -> dict[int, float]:
        """1 − IoU of each view."""
        found: dict[int, float] = {}
        with torch.no_grad():
            for i in range(0, len(views), 8):
                part = views[i : i + 8]
                found.update(zip(part, (1 - self.iou(mesh, part)).tolist(), strict=True))
        return found


def _fit_level(mesh: Mesh, fit: _Fit, level: int, levels: int) -> tuple[Mesh, OptimizationReport, float | None]:
    """Fits one mesh of fixed topology; returns the state that the held-out views liked best."""
    settings, context = fit.settings, fit.context
    scene = Scene(mesh)
    energies = prepare_energies(scene, settings.regularizers, context)
    batches = Batches(len(fit.train), max(1, settings.views_per_step), context.seed + level)
    steps = settings.iterations_per_view * len(fit.train) if settings.iterations_per_view else settings.iterations
    radius = settings.start_radius or 1.0
    rate = settings.learning_rate * radius
    optimizer: torch.optim.Optimizer
    if settings.parameterization == "large_steps":
        large = LargeSteps(mesh.topology, len(mesh.positions), settings.smoothness)
        unknown = large.encode(mesh.positions.detach()).requires_grad_(True)
        decode: Callable[[Tensor], Tensor] = large.decode
        optimizer = UniformAdam([unknown], rate)
    else:
        unknown = mesh.positions.detach().clone().requires_grad_(True)
        decode = lambda positions: positions  # noqa: E731
        optimizer = torch.optim.Adam([unknown], rate)

    def loss(step: int) -> Terms:
        current = mesh.with_positions(decode(unknown))
        views = [fit.train[i] for i in batches(step)]
        error = 1 - fit.iou(current, views)
        weight = torch.ones_like(error)
        if settings.robust:
            weights = fit.trust.update(views, error.detach().cpu().numpy(), settled=level > 0 or step > steps // 2)
            weight = torch.as_tensor(weights, dtype=error.dtype, device=error.device)
        return {"silhouette": (weight * error).sum() / len(views)} | energies(replace(scene, mesh=current))

    best = _Best(unknown)

    def locate(step: int, term: str) -> str:
        current = mesh.with_positions(decode(unknown).detach())
        if term == "silhouette":
            views = [fit.train[i] for i in batches(step)]
            return views_at_fault(current, views, fit.names, lambda moved, view: 1 - fit.iou(moved, [view]))
        return vertices_at_fault(current, lambda moved: sum_of(energies(replace(scene, mesh=moved))))

    def after_step(step: int) -> bool:
        if not fit.held or (step + 1) % CHECK_STEPS:
            return False
        with torch.no_grad():
            errors = fit.errors(mesh.with_positions(decode(unknown)), fit.held)
        error = float(np.median(list(errors.values())))
        done = level * steps + step + 1
        context.report(Progress("geometry", done, levels * steps, 0.0, {"held_out": np.array([error])}))
        idle = best.offer(unknown, error)
        # at the full rate the error rattles about a plateau; only where the rate has fallen does idleness mean an end
        return idle and step > SETTLED * steps

    report = optimize(
        loss,
        optimizer,
        Schedule(steps, end=settings.learning_rate_end),
        stage="geometry",
        report=context.report,
        after_step=after_step,
        keep=Keep(context.checkpoints / f"level_{level}.npz", context.checkpoint_seconds),
        beside=Together(best=best, trust=fit.trust),
        locate=locate,
        first_step=level * steps,
        total_steps=levels * steps,
    )
    tell_troubles(report, context.warn)
    with torch.no_grad():
        return (
            mesh.with_positions(decode(best.kept if fit.held and best.seen else unknown).detach()),
            report,
            best.error,
        )


class _Best:
    """The state of the lowest held-out error so far."""

    def __init__(self, state: Tensor) -> None:
        self.kept = state.detach().clone()
        self.error: float | None = None
        self.seen = False
        self._idle = 0

    def offer(self, state: Tensor, error: float) -> bool:
        """Keeps the state if it is better; True when it is time to stop."""
        self.seen = True
        if self.error is None or error < self.error:
            self._idle = 0 if self.error is None or error < 0.999 * self.error else self._idle + 1
            self.kept, self.error = state.detach().clone(), error
        else:
            self._idle += 1
        return self._idle >= PATIENCE_CHECKS

    def state(self) -> Arrays:
        """For a checkpoint."""
        error = np.nan if self.error is None else self.error
        return {"state": self.kept.cpu().numpy(), "error": np.asarray(error), "idle": np.asarray(self._idle)}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """From a checkpoint."""
        self.kept = torch.from_numpy(state["state"]).to(self.kept)
        self.error = None if np.isnan(state["error"]) else float(state["error"])
        self.seen, self._idle = self.error is not None, int(state["idle"])


def _hold_out(views: int, share: float) -> list[int]:
    """Views spread evenly over the capture's order."""
    count = round(views * share) if views >= 10 else 0
    return [int((i + 0.5) * views / count) for i in range(count)]


def _working_similarity(mesh: Mesh, radius: float) -> np.ndarray:
    similarity = unit_similarity(mesh)
    if radius > 0:
        similarity[:3] *= radius
    return similarity


def _moved(positions: Tensor, similarity: np.ndarray) -> Tensor:
    points = positions.detach().cpu().numpy().astype(np.float64)
    moved = points @ similarity[:3, :3].T + similarity[:3, 3]
    return torch.from_numpy(moved.astype(np.float32)).to(positions.device)


def _arrays(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    return mesh.positions.detach().cpu().numpy().astype(np.float64), mesh.faces.cpu().numpy()


def _level_count(settings: GeometrySettings, start_error: float) -> int:
    """How many meshes, coarse to fine; a start that is nearly right would only lose detail on a very coarse one."""
    if not settings.remesh:
        return 1
    return settings.levels if settings.levels > 0 else 2 if start_error < NEAR_START else 3


def _triangles(mesh: Mesh, targets: SilhouetteTargets, settings: GeometrySettings) -> int:
    """Triangles of the final mesh."""
    if settings.triangles > 0:
        return settings.triangles
    pixel = float(np.median([_pixel_size(mesh, camera) for camera in targets.cameras]))
    count = surface_area(*_arrays(mesh)) / (np.sqrt(3) / 4 * (EDGE_PIXELS * pixel) ** 2)
    return int(np.clip(count, TRIANGLES_MIN, TRIANGLES_MAX))


def _pixel_size(mesh: Mesh, camera: Camera) -> float:
    """Width of a pixel at the middle of the mesh."""
    positions = mesh.positions.detach().cpu().numpy().astype(np.float64)
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    depth = abs(float(camera.world_to_camera[2, :3] @ middle + camera.world_to_camera[2, 3]))
    return depth / float(np.sqrt(abs(np.linalg.det(camera.intrinsics[:2, :2]))))


def _mean_iou(errors: Mapping[int, float], views: list[int]) -> float | None:
    return float(np.mean([1 - errors[i] for i in views])) if views else None


def _advise_outlines(held_out: Mapping[str, float | None], context: StageContext) -> None:
    """Says aloud that the stage lost what its start had."""
    before, after = held_out["before"], held_out["after"]
    if before is not None and after is not None and before - after > WORSE:
        context.warn(
            f"the outlines of held-out views fit worse than the start's did (IoU {before:.4f} → {after:.4f}); "
            "try more triangles (geometry.triangles), or geometry.photographs='off'"
        )


def _advise(
    before: MeshState, after: MeshState, residue: Residue, fit: _Fit, names: list[str], context: StageContext
) -> None:
    """Says aloud what a user should look at."""
    if residue.missing > NOTABLE:
        view, share = residue.worst_missing
        context.warn(
            f"the mesh misses {residue.missing:.1%} of the masks' area away from the outline (most in view "
            f"{names[view]}: {share:.1%}): thin parts that the start mesh lacks cannot grow back; start finer"
        )
    if residue.filled > NOTABLE:
        view, share = residue.worst_filled
        context.warn(
            f"the mesh covers {residue.filled:.1%} more than the masks away from the outline (most in view "
            f"{names[view]}: {share:.1%}): gaps that the start mesh has closed cannot open again; start finer"
        )
    for view, weight in fit.trust.distrusted().items():
        context.warn(
            f"the mask of view {names[view]} contradicts the others and counts {weight:.0%}; look at it or leave it out"
        )
    if before.watertight and not after.watertight:
        context.warn("the fitted mesh is no longer watertight; try fewer triangles or geometry.remesh=false")
    if after.components != before.components:
        context.warn(f"the fitted mesh has {after.components} components, its start had {before.components}")
    if after.self_intersecting > before.self_intersecting:
        context.warn(
            f"{after.self_intersecting} triangles of the fitted mesh pass through others "
            f"(the start: {before.self_intersecting}); a larger geometry.smoothness avoids that"
        )
