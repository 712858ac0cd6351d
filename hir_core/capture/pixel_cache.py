"""A cache of decoded photographs, bounded in memory, that lives as long as a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import Lock

from hir_core.capture.capture import Capture
from hir_core.capture.lens import camera_lens
from hir_core.capture.pixels import Pixels

DEFAULT_BYTES = 1 << 30
"""80 views of 512² take 0.36 GB."""


class PixelCache:
    """Stores the first photographs that fit into the limit; others are decoded again each time."""

    def __init__(self, max_bytes: int = DEFAULT_BYTES) -> None:
        self._max_bytes = max_bytes
        self._cached: dict[str, Pixels] = {}
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
            self._bytes -= 0 if cached is None else _size(cached)

    def _reader(self, name: str, read: Callable[[], Pixels]) -> Callable[[], Pixels]:
        # no eviction: stages read the views in order, so that evicting the oldest would give no hit
        def read_cached() -> Pixels:
            with self._lock:
                cached = self._cached.get(name)
            if cached is not None:
                return cached
            pixels = read()
            size = _size(pixels)
            with self._lock:
                if name not in self._cached and self._bytes + size <= self._max_bytes:
                    self._cached[name] = pixels
                    self._bytes += size
            return pixels

        return read_cached


def _size(pixels: Pixels) -> int:
    mask = 0 if pixels.mask is None else pixels.mask.nbytes
    return int(pixels.color_linear.nbytes + pixels.saturated.nbytes + mask)
