"""Options of the observers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval, Unit


@dataclass(frozen=True)
class TensorBoardOptions:
    """Options of the curves for `tensorboard --logdir RUN/tensorboard`."""

    flush_seconds: Annotated[int, Interval(ge=1), Unit("s")] = 10
    """Interval at which new values are written to disk."""


@dataclass(frozen=True)
class PreviewsOptions:
    """Options of the preview images after each stage, in RUN/previews."""

    size: Annotated[int, Interval(ge=1, le=8192), Unit("pixels")] = 256
    """Side of each image."""
    sides: Annotated[int, Interval(ge=1)] = 4
    """Number of images around the object."""


@dataclass(frozen=True)
class ProgressFileOptions:
    """Options of RUN/progress.json, which holds the current step of the current stage."""

    interval_seconds: Annotated[float, Interval(ge=0), Unit("s")] = 1.0
    """Shortest time between two writes within a stage."""
