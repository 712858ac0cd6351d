"""The geometry stage: fits a mesh to the masks, then refines it by the photo-consistency of its surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GeometrySettings
from hir_core.errors import StageError
from hir_core.mesh.attribute_transfer import remeshed
from hir_core.mesh.mesh_validity import MeshState, inspect_mesh
from hir_core.mesh.self_intersection_repair import IntersectingSurface, separate_sheets, smooth_intersections
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene
from hir_core.scene.frames import unit_similarity
from hir_core.stages.geometry.geometry_advice import (
    warn_of_defects,
    warn_of_iou_loss,
    warn_of_masks,
    warn_of_residual,
)
from hir_core.stages.geometry.geometry_report import (
    CurvesReport,
    GeometryReport,
    IouChange,
    LevelReport,
    MeshChange,
    SensorDepthReport,
    SilhouetteResidualReport,
    ViewsReport,
)
from hir_core.stages.geometry.measured_depths.depth_term import depth_rays
from hir_core.stages.geometry.occlusion_boundaries.boundary_refinement import refine_occlusion_boundaries
from hir_core.stages.geometry.occlusion_boundaries.boundary_report import (
    OcclusionBoundariesReport,
    OcclusionBoundariesSkipped,
)
from hir_core.stages.geometry.photo_consistency.photo_consistency_report import (
    PhotoConsistencyReport,
    PhotoConsistencySkipped,
)
from hir_core.stages.geometry.photo_consistency.photo_refinement import refine_by_photo_consistency
from hir_core.stages.geometry.silhouettes.floating_components import remove_floating_components
from hir_core.stages.geometry.silhouettes.level_plan import level_count, triangles_of_level
from hir_core.stages.geometry.silhouettes.outline_refinement import refine_outlines
from hir_core.stages.geometry.silhouettes.silhouette_fit import SilhouetteFit, fit_mesh, pass_of_level
from hir_core.stages.geometry.silhouettes.silhouette_residual import silhouette_residual
from hir_core.stages.held_out_views import held_out_for_geometry, judging_views


@dataclass(frozen=True, eq=False)
class FittedGeometry:
    """Value of the geometry stage."""

    scene: Scene
    """With the fitted mesh."""
    silhouette_positions: Float[Tensor, "V 3"] | None = None
    """Vertices before photographs moved them; None where they did not."""


def fit_geometry(
    scene: Scene, capture: Capture, settings: GeometrySettings, context: StageContext
) -> tuple[FittedGeometry, GeometryReport]:
    """The scene with its mesh fitted to the masks of the capture's views, and the stage's report.

    While the stage runs, the world is moved in float64 so that the initial mesh is centred and of radius 1 (or
    `start_radius`). `StageError` where the initial mesh has no triangles, `CaptureError` for a view without mask or
    camera.
    """
    frame = _working_similarity(scene.mesh, settings.start_radius)
    mesh = replace(scene.mesh, positions=_transformed(scene.mesh.positions, frame))
    capture = capture.transformed(frame)
    fit = _prepare(mesh, capture, settings, context)
    everything = list(range(len(fit.targets)))
    before = inspect_mesh(*_arrays(mesh))
    initial_errors = fit.errors(mesh, everything)
    initial_distance = None if fit.depth is None else fit.depth.median_distance(mesh)
    removed = 0
    if settings.prune:
        mesh, removed = remove_floating_components(fit.renderer, mesh, fit.targets, fit.train)
    mesh, levels, curve = _fit_silhouettes(mesh, fit, float(np.median(list(initial_errors.values()))))
    mesh, report_of_outlines = refine_outlines(mesh, fit, 0)
    outlines = [report_of_outlines]
    silhouette_mesh = mesh
    photo_consistency: PhotoConsistencyReport | PhotoConsistencySkipped
    photo_consistency = PhotoConsistencySkipped("left out by the settings")
    if settings.photo_consistency == "auto":
        mesh, photo_consistency = refine_by_photo_consistency(mesh, capture, fit.iou, fit.held_out, settings, context)
    if photo_consistency.accepted:
        mesh, report_of_outlines = refine_outlines(mesh, fit, 1)
        outlines.append(report_of_outlines)
    occlusion_boundaries: OcclusionBoundariesReport | OcclusionBoundariesSkipped
    occlusion_boundaries = OcclusionBoundariesSkipped("left out by the settings")
    if settings.photo_consistency == "auto" and settings.occlusion_boundary_iterations > 0:
        mesh, occlusion_boundaries = refine_occlusion_boundaries(
            mesh, capture, fit.iou, fit.held_out, settings, context
        )
    earlier = silhouette_mesh if photo_consistency.accepted or occlusion_boundaries.accepted else None
    context.report(Progress("geometry", 0, 1, 0.0, message="self-intersections"))
    mesh, after = _repair(mesh, before.self_intersecting, earlier)
    if earlier is not None:
        earlier, _ = _repair(earlier, before.self_intersecting, None)
    errors = fit.errors(mesh, everything)
    down_weighted = fit.view_weights.down_weighted()
    residual = silhouette_residual(fit.renderer, mesh, fit.targets, [i for i in fit.train if i not in down_weighted])
    warn_of_residual(residual, fit.names, context)
    warn_of_masks(fit)
    warn_of_defects(replace(before, components=before.components - removed), after, context)
    held_out = IouChange(_mean_iou(initial_errors, fit.held_out), _mean_iou(errors, fit.held_out))
    warn_of_iou_loss(held_out, context)
    report = GeometryReport(
        iou_train=IouChange(_mean_iou(initial_errors, fit.train), _mean_iou(errors, fit.train)),
        iou_held_out=held_out,
        views=ViewsReport(
            train=len(fit.train),
            held_out=[fit.names[i] for i in fit.held_out],
            down_weighted={fit.names[i]: round(float(w), 4) for i, w in down_weighted.items()},
        ),
        floating_components_removed=removed,
        silhouette_residual=SilhouetteResidualReport(residual.missing, residual.filled),
        mesh=MeshChange(before, after),
        levels=levels,
        outlines=outlines,
        photo_consistency=photo_consistency,
        occlusion_boundaries=occlusion_boundaries,
        sensor_depth=None
        if fit.depth is None or initial_distance is None
        else SensorDepthReport(len(fit.depth.points), initial_distance, fit.depth.median_distance(mesh)),
        curves=CurvesReport(curve),
    )
    inverse = np.linalg.inv(frame)
    moved_back = replace(mesh, positions=_transformed(mesh.positions, inverse))
    silhouette_positions = None if earlier is None else _transformed(earlier.positions, inverse)
    return FittedGeometry(replace(scene, mesh=moved_back), silhouette_positions), report


def _prepare(mesh: Mesh, capture: Capture, settings: GeometrySettings, context: StageContext) -> SilhouetteFit:
    options = context.options.get("geometry_renderer", {}).get(settings.renderer, {})
    renderer: GeometryRenderer = context.plugins.create("geometry_renderer", settings.renderer, options, context.seed)
    targets = renderer.prepare(capture.views, settings.downsample).to(mesh.positions.device)
    if len(targets) == 0:
        raise StageError("the geometry stage has no views; name a capture with photographs")
    held_out = held_out_for_geometry(len(targets), settings.held_out, capture.take_numbers)
    judges = judging_views(len(targets), held_out, capture.take_numbers)
    names = [view.name for view in capture.views]
    fit = SilhouetteFit(renderer, targets, settings, context, held_out, judges, names)
    if settings.depth_weight > 0 and settings.iterations + settings.iterations_per_view > 0:
        train = [capture.views[i] for i in fit.train]
        fit.depth = depth_rays(train, settings.start_radius or 1.0, context.seed)
    return fit


def _fit_silhouettes(
    mesh: Mesh, fit: SilhouetteFit, initial_error: float
) -> tuple[Mesh, list[LevelReport], list[float]]:
    """The mesh after all levels, their reports, and the silhouette term of every step."""
    reports: list[LevelReport] = []
    curves: list[NDArray[np.floating]] = []
    levels = level_count(fit.settings, initial_error)
    for level in range(levels):
        if fit.settings.remesh:
            # from the area of the current surface: a sphere around a cow has twice the cow's area
            triangles = triangles_of_level(mesh, fit.targets, fit.settings, level, levels)
            mesh = remeshed(mesh, triangles, seed=fit.context.seed)
        mesh, loop, held_out_error = fit_mesh(mesh, fit, pass_of_level(fit, level, levels))
        curves.append(loop.curves.get("silhouette", np.zeros(0)))
        reports.append(LevelReport(len(mesh.faces), loop.steps, held_out_error, loop.stopped_early, loop.skipped))
    return mesh, reports, np.concatenate(curves).tolist() if curves else []


def _repair(mesh: Mesh, allowed: int, silhouette_mesh: Mesh | None) -> tuple[Mesh, MeshState]:
    """The mesh with self-intersections repaired down to `allowed` triangles where that is possible, and its state.

    First triangles that graze each other are pushed apart. Then, where the photo-consistency refinement moved the
    vertices, they go back towards `silhouette_mesh`, the same mesh before it. What is left is smoothed.
    """
    state = inspect_mesh(*_arrays(mesh))
    if state.self_intersecting <= allowed:
        return mesh, state
    surface = separate_sheets(IntersectingSurface.of(*_arrays(mesh)), allowed)
    if silhouette_mesh is not None:
        surface = smooth_intersections(surface, allowed, toward=_arrays(silhouette_mesh)[0])
    surface = smooth_intersections(surface, allowed)
    mesh = mesh.with_positions(torch.from_numpy(surface.positions).to(mesh.positions))
    return mesh, inspect_mesh(*_arrays(mesh))


def _working_similarity(mesh: Mesh, radius: float) -> NDArray[np.float64]:
    similarity = unit_similarity(mesh)
    if radius > 0:
        similarity[:3] *= radius
    return similarity


def _transformed(positions: Tensor, similarity: NDArray[np.floating]) -> Tensor:
    points = positions.detach().cpu().numpy().astype(np.float64)
    moved = points @ similarity[:3, :3].T + similarity[:3, 3]
    return torch.from_numpy(moved.astype(np.float32)).to(positions.device)


def _arrays(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    return mesh.positions.detach().cpu().numpy().astype(np.float64), mesh.faces.cpu().numpy()


def _mean_iou(errors: Mapping[int, float], views: list[int]) -> float | None:
    return float(np.mean([1 - errors[i] for i in views])) if views else None
