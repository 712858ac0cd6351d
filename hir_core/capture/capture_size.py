"""Number and size of a capture's photographs: what time and memory depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hir_core.capture.capture import Capture

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class CaptureSize:
    """What the memory of a run depends on."""

    views: int
    width: int
    height: int

    @property
    def pixels(self) -> int:
        """Of all photographs together."""
        return self.views * self.width * self.height


def size_of(capture: Capture) -> CaptureSize:
    """Number of photographs and the size of the largest; without cameras the first photograph is looked at."""
    sizes = [(v.camera.width, v.camera.height) for v in capture.views if v.camera is not None]
    if not sizes and capture.views:
        height, width = capture.views[0].pixels().color_linear.shape[:2]
        sizes = [(width, height)]
    width, height = max(sizes, key=lambda s: s[0] * s[1], default=(0, 0))
    return CaptureSize(len(capture.views), width, height)
