"""What the photo-consistency refinement reports: `photo_consistency` of the geometry stage in run.json."""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.stages.geometry.confirmed_movement import ConfirmedShare, HeldOutIou


@dataclass(frozen=True)
class PhotoConsistencySkipped:
    """The mesh was left as it was, and why."""

    reason: str
    accepted: bool = False


@dataclass(frozen=True)
class PassReport:
    """One optimisation at one resolution."""

    smoothness: float
    """λ of LargeSteps."""
    downsample: int
    shared: bool
    """Both candidates continue from its mesh."""
    error: list[float]
    """Mean photo-consistency error over the first and over the last tenth of the steps."""


@dataclass(frozen=True)
class ErrorChange:
    """Mean photo-consistency error of the held-out views; None where nothing could be compared."""

    before: float | None
    after: float | None


@dataclass(frozen=True)
class PhotoConsistencyReport:
    """The refinement, against the mesh that it started from."""

    accepted: bool
    """Some part of the movement is confirmed."""
    judging_views: list[str]
    """Names of the views that decided; those that are not held out joined the last pass."""
    levels: list[PassReport]
    movement: ConfirmedShare
    """From the initial mesh towards the refined one."""
    fine: ConfirmedShare
    """From the smooth candidate towards the one of low smoothness."""
    held_out_error: ErrorChange
    held_out_iou: HeldOutIou
