"""Result of a capture check."""

from __future__ import annotations

from dataclasses import dataclass, field

GAP_SIDE_PIXELS = 256
"""Gaps are in pixels of masks reduced by the largest whole factor that leaves so many on the longer side."""


@dataclass(frozen=True)
class ViewCheck:
    """One photograph. Shares are of the object's pixels if there is a mask, else of all pixels."""

    name: str
    width: int
    height: int
    saturated: float
    """Share of clipped pixels."""
    brightness: float
    """Mean linear value."""
    sharpness: float
    """Relative to the capture's median; below 0.5 the photograph is blurred or out of focus."""
    mask_share: float | None
    """Share of the image that is object; None without a mask."""
    touches_border: bool = False
    """Whether the object touches the image's border."""
    agreement: float | None = None
    """Intersection over union of the mask and the re-projected hull of all masks; None without camera or mask."""
    take: str = ""
    """Name of the photograph's take; empty where there is one take."""


@dataclass(frozen=True)
class TakeCheck:
    """One take: photographs of the object in one position, under one light."""

    name: str
    photographs: int


@dataclass(frozen=True)
class CaptureCheck:
    """Results for all photographs and for the capture."""

    views: tuple[ViewCheck, ...]
    duplicates: tuple[tuple[str, str], ...]
    """Names of a photograph and of a later one that equals it; each later one once."""
    with_camera: int
    """Number of photographs with a camera."""
    directions_covered: float | None
    """Share of the directions from the object within 30° of a camera; None without cameras."""
    flashes: int
    """Number of photographs whose EXIF record says that the flash fired."""
    headlight: float | None
    """1 for a light that moves with the camera, 0 for a static light; None if unknown."""
    mask_gap: float | None = None
    """Median width of the strip along a mask's outline that lies beside the hull of other masks, in pixels of masks
    reduced to 256 to 511 on the longer side; None without cameras, for few masks, and where none agree."""
    points: int = 0
    """Number of reconstructed points of the capture."""
    takes: tuple[TakeCheck, ...] = ()
    """The takes in their order; empty where there is one without a name."""
    advice: tuple[str, ...] = field(default=())
    """One sentence for each problem."""
