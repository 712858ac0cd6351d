"""Options of the observers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TensorBoardOptions:
    """Curves for `tensorboard --logdir RUN/tensorboard`."""

    flush_seconds: int = 10
    """How long what was written may wait before it is on the disk."""


@dataclass(frozen=True)
class PreviewsOptions:
    """A picture of the scene after each stage, in RUN/previews."""

    size: int = 256
    """Side of each of the pictures in pixels."""
    sides: int = 4
    """Pictures around the object."""
