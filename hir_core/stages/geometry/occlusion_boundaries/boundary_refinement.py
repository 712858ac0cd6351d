"""Moves occlusion boundaries to where photographs show them; silhouettes keep the outline.

Outlines do not show where a rim ends in front of the inside of a vessel, and photo-consistency compares windows that
must not cross such a boundary. Here each photograph decides at the boundaries themselves: a pixel that resembles the
farther surface pulls the boundary inwards, one that resembles the nearer surface pushes it outwards. What the surfaces
look like is known from other photographs (`predicted_colors`). Views that took no part judge how far the result goes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GeometrySettings
from hir_core.mesh.exposure_differences import exposure_corrections
from hir_core.mesh.large_steps import LargeSteps, UniformAdam
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.optimization.nonfinite_diagnostics import nonfinite_views
from hir_core.optimization.optimization_loop import Checkpointing, optimize, warn_of_skipped_steps
from hir_core.optimization.optimization_report import Terms
from hir_core.optimization.parallel_jobs import one_thread
from hir_core.optimization.schedules import Batches, Schedule
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.confirmed_movement import (
    HeldOutEvaluation,
    HeldOutIou,
    confirmed_movement,
    confirmed_share,
    interpolated,
)
from hir_core.stages.geometry.occlusion_boundaries.boundary_report import (
    OcclusionBoundariesReport,
    OcclusionBoundariesSkipped,
)
from hir_core.stages.geometry.occlusion_boundaries.boundary_samples import BoundarySamples, EdgeFaces, find_boundaries
from hir_core.stages.geometry.occlusion_boundaries.predicted_colors import VertexColors
from hir_core.stages.geometry.occlusion_boundaries.view_photographs import ViewPhotographs
from hir_core.stages.geometry.photo_consistency.detail_images import LEAST_CONTRAST_SRGB, finest_downsample
from hir_core.stages.geometry.photo_consistency.photo_pass import (
    FINAL_LEARNING_RATE,
    FINE_SMOOTHNESS,
    STEPS_PER_RAY_STRUCTURE,
)
from hir_core.stages.geometry.photo_consistency.photo_residuals import neighbouring_views, ray_structure
from hir_core.stages.held_out_views import judging_views

LEARNING_RATE = 3e-3
"""Step size as a fraction of the object's radius: boundaries are a few pixels off."""

SILHOUETTE_WEIGHT = 4.0
"""Of the outlines beside the boundaries inside them; both are shares of the mask's area. With equal weights reflections
of polished gold moved outlines off the masks, too (docs/studies/outlines.md)."""

STEPS_PER_COLORS = 36
"""Vertices are coloured anew after so many steps; a multiple of `STEPS_PER_RAY_STRUCTURE`, so that a run that continues
from a checkpoint does the same."""

EARLY_STEPS = (STEPS_PER_COLORS, 2 * STEPS_PER_COLORS)
"""After so many steps the judging views are asked whether to go on."""

LEAST_EARLY_GAIN = 0.001
"""Relative fall of their error by then, below which the boundaries are left as they are: where the whole fit gained
more than half a per cent, most of it was there by then (docs/studies/occlusion_boundaries.md#steps-and-views)."""

LINE = (0.0, 0.5, 1.0)
"""Shares of the way between the two meshes at which the judging views are evaluated."""

LEAST_GAIN = 0.005
"""Relative fall of the error of judging views of which half is believed, even where they agree."""

ERROR_MAX_SRGB = 0.3
"""A larger difference between a photograph and its prediction counts as this: a highlight, or something else."""

ERROR_OF_PHOTOGRAPHS_SRGB = 0.01
"""Added to every mean: below it a difference is noise, of which a large relative change says nothing."""

EVALUATED_PIXELS_PER_VIEW = 20_000

LEAST_KNOWN = 0.5
"""Share of a face's corners, by their weights, whose colour must be known."""


def refine_occlusion_boundaries(
    mesh: Mesh,
    capture: Capture,
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]],
    held_out: Sequence[int],
    settings: GeometrySettings,
    context: StageContext,
) -> tuple[Mesh, OcclusionBoundariesReport | OcclusionBoundariesSkipped]:
    """The mesh with its occlusion boundaries moved as far as judging views confirm it, and the report.

    `capture` has the object centred and of radius about 1; `iou(mesh, views)` is differentiable. The judging views take
    no part in the fit. Without them, or without boundaries, the mesh is returned as it is and the report says why.
    """
    takes = capture.take_numbers
    judges = judging_views(len(capture.views), held_out, takes)
    train = [i for i in range(len(capture.views)) if i not in set(judges)]
    neighbours = neighbouring_views(capture.cameras, train, takes)
    judges, train = ([i for i in views if neighbours[i]] for views in (judges, train))
    if not judges or not train:
        return mesh, OcclusionBoundariesSkipped("too few views that overlap and could be held out")
    downsample = finest_downsample(capture.views, settings.downsample)
    photographs = ViewPhotographs.of(capture.views, downsample, mesh.positions.device)
    positions, normals, faces = (each.detach().cpu().numpy() for each in (mesh.positions, mesh.normals, mesh.faces))
    factors = exposure_corrections(positions, normals, faces, capture)
    if factors is not None:
        photographs = photographs.multiplied(factors)
    fit = _BoundaryFit(mesh, photographs, train, neighbours, iou)
    if not fit.has_boundaries(mesh):
        return mesh, OcclusionBoundariesSkipped("no part of the object hides another in any view")

    def judged(candidate: Mesh) -> HeldOutEvaluation:
        errors = _prediction_errors(candidate, photographs, judges, neighbours)
        with torch.no_grad():
            return HeldOutEvaluation(errors, float(iou(candidate, list(held_out)).mean()))

    initial = judged(mesh)

    def evaluated(candidate: Mesh) -> HeldOutEvaluation:
        return initial if candidate is mesh else judged(candidate)

    def is_promising(candidate: Mesh) -> bool:
        errors = np.stack([initial.errors, judged(candidate).errors])
        return confirmed_share((0.0, 1.0), errors, LEAST_GAIN).gain >= LEAST_EARLY_GAIN

    fitted, curve = _fit(mesh, fit, settings, context, [view.name for view in capture.views], is_promising)
    if fitted is None:
        least = f"{100 * LEAST_EARLY_GAIN:g} %"
        return mesh, OcclusionBoundariesSkipped(f"after {len(curve)} steps the judging views gain less than {least}")
    movement, (before, after) = confirmed_movement(mesh, fitted, evaluated, LINE, LEAST_GAIN)
    part = max(1, len(curve) // 10)
    report = OcclusionBoundariesReport(
        accepted=movement.share > 0,
        judging_views=[capture.views[i].name for i in judges],
        movement=movement.rounded(),
        disagreement=[round(float(np.mean(c)), 5) for c in (curve[:part], curve[-part:])] if len(curve) else [],
        held_out_iou=HeldOutIou(round(before, 5), round(after, 5)),
    )
    return interpolated(mesh, fitted, movement.share), report


@dataclass(eq=False)
class _BoundaryFit:
    """The error of boundaries in a batch of views, with colours that are renewed now and then."""

    mesh: Mesh
    photographs: ViewPhotographs
    train: list[int]
    neighbours: Sequence[Sequence[int]]
    iou: Callable[[Mesh, list[int]], Float[Tensor, " B"]]

    def __post_init__(self) -> None:
        self._edges = EdgeFaces.of(self.mesh.topology)
        self._tracer: MeshQueries | None = None
        self._colors: VertexColors | None = None
        self._variance: Tensor | None = None

    def has_boundaries(self, mesh: Mesh) -> bool:
        """Whether any training view shows one."""
        tracer = ray_structure(mesh)
        return any(len(find_boundaries(mesh, self._edges, self.photographs, [view], tracer).row) for view in self.train)

    def prepare(self, mesh: Mesh, step: int) -> None:
        """Renews what is due at a step."""
        if step % STEPS_PER_RAY_STRUCTURE == 0 or self._tracer is None:
            self._tracer = ray_structure(mesh)
        if step % STEPS_PER_COLORS == 0 or self._colors is None:
            with torch.no_grad():
                self._colors = VertexColors(mesh, self.photographs, self.train, self.neighbours, self._tracer)
                self._variance = self._colors.variance()

    def boundary_error(self, mesh: Mesh, views: list[int]) -> Tensor:
        """Mean |r| over the boundaries of the views. Its derivative is that of the boundary integral of r, as a share
        of the masks' area: the unit of the silhouette's error.
        """
        assert self._tracer is not None
        samples = find_boundaries(mesh, self._edges, self.photographs, views, self._tracer)
        if len(samples.row) == 0:
            return 0.0 * mesh.positions.sum().double()
        r = self._preference(mesh, samples)
        areas = self.photographs.areas[views][samples.row]
        motion = samples.outward_motion(mesh.positions, self.photographs)
        integral = (r * motion * samples.length / areas).sum() / len(views)
        return integral + (r.abs() * samples.length).sum() / samples.length.sum()

    @torch.no_grad()
    def _preference(self, mesh: Mesh, samples: BoundarySamples) -> Float[Tensor, " S"]:
        """r in −1…1: −1 where the photograph shows the nearer surface at the boundary, 1 where the farther one.

        r = (a − b) / (a + b), where a and b are the squared differences of the photograph from the nearer and the
        farther surface's colour, plus the variance of these colours. 0 where a colour is unknown.
        """
        assert self._colors is not None and self._variance is not None
        colors, known = self._colors.predicted(samples.views)
        view = torch.tensor(samples.views, device=samples.row.device)[samples.row]
        photograph, covered = self.photographs.colors_at(view, samples.pixels)
        near, far = (
            _surface_error(photograph, mesh.faces[face], weights, samples.row, colors, known, self._variance)
            for face, weights in (
                (samples.near_face, samples.near_weights),
                (samples.far_face, samples.far_weights),
            )
        )
        r = (near[0] - far[0]) / (near[0] + far[0])
        return torch.where(near[1] & far[1] & covered, r, 0.0).double()


def _surface_error(
    photograph: Float[Tensor, "S 3"],
    corners: Int[Tensor, "S 3"],
    weights: Float[Tensor, "S 3"],
    row: Int[Tensor, " S"],
    colors: Float[Tensor, "V B 3"],
    known: Tensor,
    variance: Float[Tensor, " V"],
) -> tuple[Float[Tensor, " S"], Tensor]:
    """Squared difference from a surface's colour plus its variance, and whether that colour is known."""
    color, share = _interpolated(corners, weights, row, colors, known)
    uncertainty = (variance[corners] * weights).sum(dim=1) + LEAST_CONTRAST_SRGB**2
    return (color - photograph).square().sum(dim=1) + uncertainty, share > LEAST_KNOWN


def _interpolated(
    corners: Int[Tensor, "S 3"],
    weights: Float[Tensor, "S 3"],
    row: Int[Tensor, " S"],
    colors: Float[Tensor, "V B 3"],
    known: Tensor,
) -> tuple[Float[Tensor, "S 3"], Float[Tensor, " S"]]:
    """Colours at points of faces, of the corners that are known, and the share of these corners' weights."""
    used = weights.to(colors) * known[corners, row[:, None]]
    share = used.sum(dim=1)
    color = (colors[corners, row[:, None]] * used[..., None]).sum(dim=1) / share.clamp_min(1e-6)[:, None]
    return color, share


@one_thread()
def _fit(
    mesh: Mesh,
    fit: _BoundaryFit,
    settings: GeometrySettings,
    context: StageContext,
    names: list[str],
    is_promising: Callable[[Mesh], bool],
) -> tuple[Mesh | None, Float[np.ndarray, " steps"]]:
    """The mesh after the optimisation, None where it is not promising after `EARLY_STEPS`, and the boundaries' error at
    each step.
    """
    large = LargeSteps(mesh.topology, len(mesh.positions), FINE_SMOOTHNESS)
    parameter = large.encode(mesh.positions.detach()).requires_grad_(True)
    batches = Batches(len(fit.train), max(1, settings.views_per_step // 2), context.seed)
    steps = settings.occlusion_boundary_iterations

    def loss(step: int) -> Terms:
        current = mesh.with_positions(large.decode(parameter))
        fit.prepare(current, step)
        views = [fit.train[i] for i in batches(step)]
        silhouette = (1 - fit.iou(current, views)).mean()
        return {
            "occlusion_boundary": fit.boundary_error(current, views).to(parameter),
            "silhouette": SILHOUETTE_WEIGHT * silhouette.to(parameter),
        }

    def locate(step: int, term: str) -> str:
        current = mesh.with_positions(large.decode(parameter).detach())
        views = [fit.train[i] for i in batches(step)]
        if term == "silhouette":
            return nonfinite_views(current, views, names, lambda moved, view: 1 - fit.iou(moved, [view]))
        return nonfinite_views(current, views, names, lambda moved, view: fit.boundary_error(moved, [view]))

    def ends(step: int) -> bool:
        if step + 1 not in EARLY_STEPS:
            return False
        with torch.no_grad():
            return not is_promising(mesh.with_positions(large.decode(parameter).detach()))

    report = optimize(
        loss,
        UniformAdam([parameter], LEARNING_RATE),
        Schedule(steps, end=FINAL_LEARNING_RATE),
        stage="geometry",
        report=lambda progress: context.report(replace(progress, message="occlusion boundaries")),
        checkpointing=Checkpointing(
            context.checkpoints / "occlusion_boundaries.npz", context.checkpoint_seconds, STEPS_PER_COLORS
        ),
        locate=locate,
        after_step=ends,
    )
    warn_of_skipped_steps(report, context.warn)
    with torch.no_grad():
        curve = report.curves.get("occlusion_boundary", np.zeros(0))
        ended = report.steps < steps
        return None if ended else mesh.with_positions(large.decode(parameter).detach()), curve


@torch.no_grad()
def _prediction_errors(
    mesh: Mesh, photographs: ViewPhotographs, judges: Sequence[int], neighbours: Sequence[Sequence[int]]
) -> Float[np.ndarray, " J"]:
    """Mean difference in sRGB between each judging view and its prediction from its neighbours, per pixel of the
    object, plus `ERROR_OF_PHOTOGRAPHS_SRGB`; NaN where nothing can be compared.

    A pixel that either the mesh or the mask covers, but not both, counts as `ERROR_MAX_SRGB`.
    """
    tracer = ray_structure(mesh)
    others = sorted({other for view in judges for other in neighbours[view]})
    vertex_colors = VertexColors(mesh, photographs, others, neighbours, tracer)
    errors = []
    for view in judges:
        inside = photographs.inside[view]
        pixels = (inside | photographs.outside[view]).nonzero()
        pixels = pixels[:: max(1, int(inside.sum()) // EVALUATED_PIXELS_PER_VIEW)]
        covered = inside[pixels[:, 0], pixels[:, 1]]
        centers = pixels.flip(1).double() + 0.5
        origins, directions = photographs.cameras[view].rays(centers.cpu().numpy())
        found, weights = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        face = torch.from_numpy(found).to(pixels.device)
        hit = ((face >= 0) & covered).nonzero()[:, 0]
        corners = mesh.faces[face[hit]]
        colors, known = vertex_colors.predicted([view])
        row = torch.zeros(len(hit), dtype=torch.long, device=pixels.device)
        color, share = _interpolated(corners, torch.from_numpy(weights).to(face.device)[hit], row, colors, known)
        photograph, _ = photographs.colors_at(row + view, centers[hit])
        difference = (color - photograph).abs().mean(dim=1).clamp_max(ERROR_MAX_SRGB)[share > LEAST_KNOWN]
        wrong = ERROR_MAX_SRGB * int(((face >= 0) != covered).sum())
        mean = float((difference.sum() + wrong) / covered.sum().clamp_min(1))
        errors.append(mean + ERROR_OF_PHOTOGRAPHS_SRGB if len(difference) else np.nan)
    return np.array(errors)
