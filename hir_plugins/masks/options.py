"""Options of the built-in mask sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class FolderOptions:
    """Masks in files, white on the object."""

    path: str = ""
    """The folder, relative to the capture; empty looks for `masks`, `mask` and the like. Its files are matched to the
    photographs by name: the same stem, `photo.jpg.png`, `photo_mask.png`, in any case."""
    inverted: bool = False
    """The masks are white on the background."""


@dataclass(frozen=True)
class ColorKeyOptions:
    """A background of one colour."""

    color: Literal["auto", "black", "white", "green", "blue"] = "auto"
    """The background's colour; `auto` takes the one that the pictures' borders have."""
    tolerance: float = 0.06
    """Distance in sRGB (0 to 1.7) from that colour below which a pixel is background."""
