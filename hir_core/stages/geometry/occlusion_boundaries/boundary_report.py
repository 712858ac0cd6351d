"""What the refinement of occlusion boundaries reports: `occlusion_boundaries` of the geometry stage in run.json."""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.stages.geometry.confirmed_movement import ConfirmedShare, HeldOutIou


@dataclass(frozen=True)
class OcclusionBoundariesSkipped:
    """The boundaries were left as they are, and why."""

    reason: str
    accepted: bool = False


@dataclass(frozen=True)
class OcclusionBoundariesReport:
    """The refinement, against the mesh that it started from."""

    accepted: bool
    """Some part of the movement is confirmed."""
    judging_views: list[str]
    """Names of the views that took no part in it and decided."""
    movement: ConfirmedShare
    """From the initial mesh towards the refined one."""
    disagreement: list[float]
    """Mean |r| over the first and the last tenth of the steps: 1 where photographs say clearly that a boundary lies
    elsewhere, 0 where they are in balance."""
    held_out_iou: HeldOutIou
