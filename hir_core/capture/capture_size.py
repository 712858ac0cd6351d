"""Number and size of a capture's photographs, which determine time and memory."""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.capture.capture import Capture


@dataclass(frozen=True)
class CaptureSize:
    """Number of photographs, size of the largest one in pixels, and number of takes."""

    views: int
    width: int
    height: int
    takes: int = 1

    @property
    def pixels(self) -> int:
        """Of all photographs together."""
        return self.views * self.width * self.height


def size_of(capture: Capture) -> CaptureSize:
    """Number of photographs and the size of the largest; without cameras that of the first photograph."""
    sizes = [(v.camera.width, v.camera.height) for v in capture.views if v.camera is not None]
    if not sizes and capture.views:
        height, width = capture.views[0].pixels().color_linear.shape[:2]
        sizes = [(width, height)]
    width, height = max(sizes, key=lambda s: s[0] * s[1], default=(0, 0))
    return CaptureSize(len(capture.views), width, height, len(capture.takes))
