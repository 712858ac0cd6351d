"""Options of the built-in mask sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, Unit

from hir_core.plugins.options import seed_of_run


@dataclass(frozen=True)
class FolderOptions:
    """Options of mask files, which are white on the object."""

    path: str = ""
    """The folder, relative to the capture; if empty, the usual names such as `masks` are tried. Files are matched with
    the photographs by name: the same stem, `photo.jpg.png`, `photo_mask.png`; upper and lower case are equal."""
    inverted: bool = False
    """Masks are white on the background."""


@dataclass(frozen=True)
class ColorKeyOptions:
    """Options of chroma keying."""

    color: Literal["auto", "black", "white", "green", "blue"] = "auto"
    """The background's colour; `auto` takes the colour of the photographs' borders."""
    tolerance: Annotated[float, Interval(gt=0)] = 0.06
    """Distance from that colour in sRGB (0 to 1.7) below which a pixel is background."""


@dataclass(frozen=True)
class GrabCutOptions:
    """Options of GrabCut, initialised by reconstructed points."""

    max_image_size: Annotated[int, Interval(ge=32), Unit("pixels")] = 640
    """GrabCut runs on photographs reduced to about this longer side; the edge is refined at full resolution."""
    rounds: Annotated[int, Interval(ge=0)] = 2
    """Number of times the masks are made consistent by their visual hull and cut again."""
    iterations: Annotated[int, Interval(ge=1)] = 2
    """Iterations of each cut: the colours of object and background are learnt, then the photograph is cut by them."""
    margin: Annotated[float, Interval(ge=0)] = 0.25
    """Largest distance of the object from the reconstructed points in the first cut, relative to their radius."""
    agreement: Annotated[float, Interval(ge=0, le=1)] = 0.8
    """A point is object if at least this share of the photographs that show it have object there."""
    seed: int = seed_of_run()
    """Seed of the clusters that the colour models start from; the run's, unless it is set."""


@dataclass(frozen=True)
class RembgOptions:
    """Options of rembg, a network that separates foreground and background."""

    model: str = "u2net"
    """Name of one of rembg's models; its weights must be on this machine (`rembg d u2net` downloads them)."""
    weights: str = ""
    """ONNX file of weights to use instead, with U²-Net's input and output; relative to the capture."""
