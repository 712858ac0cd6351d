"""Options of the observers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TensorBoardOptions:
    """Options of the curves for `tensorboard --logdir RUN/tensorboard`."""

    flush_seconds: int = 10
    """Interval at which new values are written to disk."""


@dataclass(frozen=True)
class PreviewsOptions:
    """Options of the preview images after each stage, in RUN/previews."""

    size: int = 256
    """Side of each image in pixels."""
    sides: int = 4
    """Number of images around the object."""
