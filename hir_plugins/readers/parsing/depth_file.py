"""One depth map on disk, and the confidence beside it: images of whole numbers, read on demand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import DepthPixels, MeasuredDepth
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.decoding.picture_decoding import read_encoded

MILLIMETRE: Final = 0.001
ARKIT_LEVELS: Final = 2
"""ARKit's confidences are 0, 1 and 2; files that hold nothing larger hold these."""


@dataclass(frozen=True)
class DepthFile:
    """Reads a depth map, and its confidence file, when called; picklable, without pixels in memory."""

    path: Path
    confidence_path: Path | None
    unit: float
    """Length in the world of the file's cameras of one unit of the map."""

    def __call__(self) -> DepthPixels:
        depth = _one_channel(self.path).astype(np.float32) * np.float32(self.unit)
        known = depth > 0
        if self.confidence_path is None:
            return DepthPixels(depth, known.astype(np.float32))
        levels = _one_channel(self.confidence_path)
        if levels.shape != depth.shape:
            raise CaptureError(
                f"the confidence {self.confidence_path} is {levels.shape[1]}×{levels.shape[0]}, its depth map "
                f"{depth.shape[1]}×{depth.shape[0]}; give them the same size"
            )
        return DepthPixels(depth, np.where(known, confidence_shares(levels), np.float32(0)))


def confidence_shares(levels: NDArray[np.unsignedinteger]) -> NDArray[np.float32]:
    """Confidences 0…1 of ARKit's levels, or of shares of the largest number of their type."""
    largest = ARKIT_LEVELS if levels.max(initial=0) <= ARKIT_LEVELS else np.iinfo(levels.dtype).max
    return levels.astype(np.float32) / np.float32(largest)


def depth_map(path: Path, confidence: Path | None, unit: float) -> MeasuredDepth:
    """The depth of one photograph; the files are opened when it is asked for."""
    paths = (path,) if confidence is None else (path, confidence)
    return MeasuredDepth(DepthFile(path, confidence, unit), paths=paths)


def _one_channel(path: Path) -> NDArray[np.unsignedinteger]:
    pixels = read_encoded(path)
    if pixels.shape[2] != 1 or pixels.dtype not in (np.uint8, np.uint16):
        raise CaptureError(f"{path} is no map of whole numbers; save depths as PNG of one channel with 16 bits")
    return np.asarray(pixels[..., 0])
