"""What the photo-consistency refinement reports: `photo_consistency` of the geometry stage in run.json."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PhotoConsistencySkipped:
    """The photographs were not compared, and why."""

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
class FineCandidateReport:
    """The candidate of low smoothness against the smooth one, on held-out views."""

    accepted: bool
    gain: float
    """Mean relative fall of the error."""
    noise: float
    """Standard error of the gain."""


@dataclass(frozen=True)
class ErrorChange:
    """Mean photo-consistency error of the held-out views; None where nothing could be compared."""

    before: float | None
    after: float | None


@dataclass(frozen=True)
class HeldOutIou:
    """Mean IoU of the held-out views."""

    before: float
    after: float


@dataclass(frozen=True)
class PhotoConsistencyReport:
    """The refinement: the mesh that was selected against the mesh it started from."""

    accepted: bool
    levels: list[PassReport]
    fine: FineCandidateReport
    held_out_gain: float
    """Mean relative fall of the error."""
    noise: float
    """Standard error of the gain."""
    held_out_error: ErrorChange
    held_out_iou: HeldOutIou
