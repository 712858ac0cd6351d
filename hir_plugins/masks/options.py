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


@dataclass(frozen=True)
class GrabCutOptions:
    """Separates the object by colour, from where the reconstruction says that it is."""

    max_image_size: int = 640
    """The cut runs on photographs made smaller to about this longer side; its edge is refined at full size."""
    rounds: int = 2
    """How often the masks are cut, made consistent by their visual hull, and cut again."""
    margin: float = 0.25
    """How far beyond the reconstructed points, in their radius, the object may reach at first."""
    agreement: float = 0.8
    """Share of the photographs that show a place in which it must look like the object to belong to it."""


@dataclass(frozen=True)
class RembgOptions:
    """A network that tells objects from what is behind them."""

    model: str = "u2net"
    """Its name among rembg's models; its weights must be on this machine (`rembg d u2net` fetches them)."""
    weights: str = ""
    """A file of weights instead, in ONNX and of U²-Net's form, relative to the capture."""
