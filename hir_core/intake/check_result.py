"""What a check of a capture reports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class ViewCheck:
    """One photograph. Shares are of the object's pixels where there is a mask, else of all."""

    name: str
    width: int
    height: int
    saturated: float
    """Share of clipped pixels."""
    brightness: float
    """Mean linear value."""
    sharpness: float
    """Relative to the capture's median; much below 1 is blurred or out of focus."""
    mask_share: float | None
    """Share of the picture that is object; None without a mask."""
    touches_border: bool = False
    agreement: float | None = None
    """Intersection over union of the mask and of what all masks and cameras together leave there."""


@dataclass(frozen=True)
class CaptureCheck:
    """The findings, and sentences for what should be mended or known."""

    views: tuple[ViewCheck, ...]
    duplicates: tuple[tuple[str, str], ...]
    with_camera: int
    directions_covered: float | None
    """Share of the sphere of directions within 30° of some camera, seen from the object; None without cameras."""
    flashes: int
    """Photographs whose record says that the flash fired."""
    headlight: float | None
    """1 for a light carried by the camera, 0 for one that stands in the world; None where it cannot be told."""
    advice: tuple[str, ...] = field(default=())
