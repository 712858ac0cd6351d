"""What the geometry stage reports; the fields are the keys of its report in run.json."""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.mesh.mesh_validity import MeshState
from hir_core.stages.geometry.occlusion_boundaries.boundary_report import (
    OcclusionBoundariesReport,
    OcclusionBoundariesSkipped,
)
from hir_core.stages.geometry.photo_consistency.photo_consistency_report import (
    PhotoConsistencyReport,
    PhotoConsistencySkipped,
)
from hir_core.stages.geometry.silhouettes.outline_refinement import OutlinesReport, OutlinesSkipped


@dataclass(frozen=True)
class IouChange:
    """Mean IoU of silhouettes and masks; None where there are no such views."""

    before: float | None
    after: float | None


@dataclass(frozen=True)
class ViewsReport:
    """Which views took part."""

    train: int
    """How many views the mesh was fitted to."""
    held_out: list[str]
    """Names of the views that only decided."""
    down_weighted: dict[str, float]
    """Views whose masks contradict the others, with their final weight in 0…1."""


@dataclass(frozen=True)
class SilhouetteResidualReport:
    """Mean area, as a share of the mask, that the fitted mesh does not explain."""

    missing: float
    filled: float


@dataclass(frozen=True)
class SensorDepthReport:
    """Median distance of measured depths from the surface, along its normal, in radii of the initial mesh."""

    rays: int
    before: float
    after: float


@dataclass(frozen=True)
class MeshChange:
    """The mesh before and after the stage."""

    before: MeshState
    after: MeshState


@dataclass(frozen=True)
class LevelReport:
    """The fit of one mesh of fixed topology."""

    triangles: int
    steps: int
    held_out_error: float | None
    """Lowest median of 1 − IoU of the held-out views; None without held-out views."""
    stopped_early: bool
    skipped_steps: dict[str, int]
    """Steps without a finite gradient, by the term that caused it."""


@dataclass(frozen=True)
class CurvesReport:
    """One value for each step of all levels."""

    silhouette: list[float]


@dataclass(frozen=True)
class GeometryReport:
    """The whole stage."""

    iou_train: IouChange
    iou_held_out: IouChange
    views: ViewsReport
    floating_components_removed: int
    silhouette_residual: SilhouetteResidualReport
    mesh: MeshChange
    levels: list[LevelReport]
    outlines: list[OutlinesReport | OutlinesSkipped]
    """Refinements of the outlines: after the levels, and after photographs moved the mesh."""
    photo_consistency: PhotoConsistencyReport | PhotoConsistencySkipped
    occlusion_boundaries: OcclusionBoundariesReport | OcclusionBoundariesSkipped
    sensor_depth: SensorDepthReport | None
    """None where no measured depth took part."""
    curves: CurvesReport
