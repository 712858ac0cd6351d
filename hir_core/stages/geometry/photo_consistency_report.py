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
class ConfirmedShare:
    """The share of a movement of the vertices that held-out views confirm."""

    share: float
    """0…1."""
    gain: float
    """Mean relative fall of the error over the views at the length of lowest error, or at 1 where that is 0."""
    noise: float
    """Standard error of the gain."""
    near_tie: bool
    """Student's 95 % interval of the gain contains 0, or the share is between 0.1 and 0.9."""

    def rounded(self) -> ConfirmedShare:
        """For the report."""
        return ConfirmedShare(round(self.share, 4), round(self.gain, 5), round(self.noise, 5), self.near_tie)


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
