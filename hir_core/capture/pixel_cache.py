"""A cache of decoded photographs, bounded in memory, that lives as long as a run.

It holds 16-bit floats, which take half the memory. Their relative error is 2⁻¹¹ at most; a step of an 8-bit photograph
is at least ten times as much. A photograph has the same rounded values whether the cache holds it or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.capture import Capture
from hir_core.capture.lens import camera_lens
from hir_core.capture.pixels import Pixels

DEFAULT_BYTES = 512 << 20
"""80 views of 512² take 0.17 GB."""

PIXEL_BYTES = 6 + 2
"""Of a stored pixel: colour and mask. The clipped pixels take a bit each."""

_LEAST_MAXIMUM, _MOST_MAXIMUM = 1e-2, 6e4
"""The largest value of a photograph whose colours are stored as 16-bit floats. Those below 6e-5 are less exact, and
there are none above 65,504."""


@dataclass(frozen=True)
class _StoredPixels:
    """What `Pixels` holds, in less memory."""

    color: NDArray[np.float16] | NDArray[np.float32]
    mask: NDArray[np.float16] | None
    clipped: NDArray[np.uint8]
    """A bit for each pixel."""

    @classmethod
    def of(cls, pixels: Pixels) -> _StoredPixels:
        color = pixels.color_linear
        largest = float(np.nanmax(np.abs(color), initial=0.0, where=~np.isnan(color)))
        short = _LEAST_MAXIMUM <= largest <= _MOST_MAXIMUM
        mask = None if pixels.mask is None else pixels.mask.astype(np.float16)
        return cls(color.astype(np.float16) if short else color, mask, np.packbits(pixels.saturated))

    def pixels(self) -> Pixels:
        """The photograph."""
        height, width = self.color.shape[:2]
        clipped = np.unpackbits(self.clipped, count=height * width).reshape(height, width).astype(bool)
        mask = None if self.mask is None else self.mask.astype(np.float32)
        return Pixels(self.color.astype(np.float32), mask, clipped)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        return self.color.nbytes + self.clipped.nbytes + (0 if self.mask is None else self.mask.nbytes)


class PixelCache:
    """Stores the first photographs that fit into the limit; others are decoded again each time."""

    def __init__(self, max_bytes: int = DEFAULT_BYTES) -> None:
        self._max_bytes = max_bytes
        self._cached: dict[str, _StoredPixels] = {}
        self._bytes = 0
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """Memory in use."""
        return self._bytes

    def wrap(self, capture: Capture) -> Capture:
        """The same capture with views that read through this cache."""
        return replace(capture, views=tuple(replace(v, read=self._reader(v.name, v.read)) for v in capture.views))

    def undistort(self, capture: Capture) -> Capture:
        """The same capture with undistorted photographs: they are undistorted once and cached."""
        views = []
        for view in capture.views:
            if view.camera is not None and any(view.distortion):
                self._forget(view.name)
                without_mask = replace(view, mask=None)
                depth = view.depth
                if depth is not None:
                    depth = replace(depth, lens=camera_lens(view.camera, view.distortion))
                read = self._reader(f"{view.name} undistorted", without_mask.pixels)
                view = replace(view, read=read, distortion=(), depth=depth)
            views.append(view)
        return replace(capture, views=tuple(views))

    def _forget(self, name: str) -> None:
        with self._lock:
            cached = self._cached.pop(name, None)
            self._bytes -= 0 if cached is None else cached.bytes

    def _reader(self, name: str, read: Callable[[], Pixels]) -> Callable[[], Pixels]:
        # no eviction: stages read the views in order, so that evicting the oldest would give no hit
        def read_cached() -> Pixels:
            with self._lock:
                cached = self._cached.get(name)
            if cached is not None:
                return cached.pixels()
            stored = _StoredPixels.of(read())
            with self._lock:
                if name not in self._cached and self._bytes + stored.bytes <= self._max_bytes:
                    self._cached[name] = stored
                    self._bytes += stored.bytes
            return stored.pixels()

        return read_cached
