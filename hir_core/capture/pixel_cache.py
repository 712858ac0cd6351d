"""Keeps decoded photographs for the length of a run, within a bound, so that no file is decoded twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import Lock

from hir_core.capture.capture import Capture
from hir_core.capture.pixels import Pixels

DEFAULT_BYTES = 1 << 30
"""80 views of 512² take 0.36 GB."""


class PixelCache:
    """Decoded photographs, the first ones that fit; the others are decoded again when they are asked for."""

    def __init__(self, max_bytes: int = DEFAULT_BYTES) -> None:
        self._max_bytes = max_bytes
        self._kept: dict[str, Pixels] = {}
        self._bytes = 0
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """Memory that is taken."""
        return self._bytes

    def wrap(self, capture: Capture) -> Capture:
        """The same capture, whose views read through this cache."""
        return replace(capture, views=tuple(replace(v, read=self._reader(v.name, v.read)) for v in capture.views))

    def undistort(self, capture: Capture) -> Capture:
        """The same capture, its photographs without lens distortion from here on: that too is done once."""
        views = []
        for view in capture.views:
            if view.camera is not None and any(view.distortion):
                self._forget(view.name)
                plain = replace(view, mask=None)
                view = replace(view, read=self._reader(f"{view.name} undistorted", plain.pixels), distortion=())
            views.append(view)
        return replace(capture, views=tuple(views))

    def _forget(self, name: str) -> None:
        with self._lock:
            kept = self._kept.pop(name, None)
            self._bytes -= 0 if kept is None else _size(kept)

    def _reader(self, name: str, read: Callable[[], Pixels]) -> Callable[[], Pixels]:
        # no eviction: stages go through the views in order, where dropping the oldest would never be a hit
        def cached() -> Pixels:
            with self._lock:
                kept = self._kept.get(name)
            if kept is not None:
                return kept
            pixels = read()
            size = _size(pixels)
            with self._lock:
                if name not in self._kept and self._bytes + size <= self._max_bytes:
                    self._kept[name] = pixels
                    self._bytes += size
            return pixels

        return cached


def _size(pixels: Pixels) -> int:
    mask = 0 if pixels.mask is None else pixels.mask.nbytes
    return int(pixels.color_linear.nbytes + pixels.saturated.nbytes + mask)
