"""Captures of analytic shapes: exact, antialiased masks from cameras on a ring or a dome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, Pixels, View

Inside = Callable[[Array, Array], NDArray[np.bool_]]
"""Which rays (origins N 3, directions N 3) hit the shape."""


def look_at(position: Array, target: Array, focal: float, width: int, height: int) -> Camera:
    forward = target - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0] if abs(forward[1]) < 0.999 else [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(intrinsics, pose, width, height)


def dome(count: int, distance: float, target: Array, focal: float, size: int) -> list[Camera]:
    """Cameras spread over a sphere (golden angle), all looking at `target`."""
    i = np.arange(count) + 0.5
    y = 1 - 2 * i / count * 0.97 - 0.015
    turn = np.pi * (3 - np.sqrt(5)) * i
    r = np.sqrt(1 - y * y)
    places = target + distance * np.stack([r * np.cos(turn), y, r * np.sin(turn)], axis=1)
    return [look_at(p, target, focal, size, size) for p in places]


def hits_sphere(center: Array, radius: float) -> Inside:
    def inside(origins: Array, directions: Array) -> NDArray[np.bool_]:
        offset = center - origins
        along = (offset * directions).sum(axis=1)
        return (offset**2).sum(axis=1) - along**2 < radius**2

    return inside


def hits_boxes(boxes: Array) -> Inside:
    """`boxes` (B, 2, 3): lowest and highest corner of each."""

    def inside(origins: Array, directions: Array) -> NDArray[np.bool_]:
        hit = np.zeros(len(origins), dtype=bool)
        with np.errstate(divide="ignore"):
            inverse = 1 / directions
        for low, high in boxes:
            a, b = (low - origins) * inverse, (high - origins) * inverse
            hit |= np.minimum(a, b).max(axis=1) < np.maximum(a, b).min(axis=1)
        return hit

    return inside


def coverage(camera: Camera, inside: Inside, samples: int = 4) -> NDArray[np.float32]:
    """Share of samples² rays through each pixel that hit the shape."""
    offset = (np.arange(samples) + 0.5) / samples
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    total = np.zeros(rows.shape, dtype=np.float32)
    for dy in offset:
        for dx in offset:
            pixels = np.stack([columns + dx, rows + dy], axis=-1).reshape(-1, 2)
            total += inside(*camera.rays(pixels)).reshape(total.shape)
    return total / samples**2


@dataclass(frozen=True)
class Fixed:
    """Pixels that are in memory."""

    pixels: Pixels

    def __call__(self) -> Pixels:
        return self.pixels


def make_view(name: str, camera: Camera, mask: NDArray[np.float32], color: NDArray[np.float32] | None = None) -> View:
    image = np.full((*mask.shape, 3), 0.25, np.float32) if color is None else color
    return View(name, camera, Fixed(Pixels(image, mask, np.zeros(mask.shape, bool))))


def shape_capture(cameras: list[Camera], inside: Inside) -> Capture:
    views = tuple(make_view(f"{i:03d}", c, coverage(c, inside)) for i, c in enumerate(cameras))
    return Capture(Path("made-in-memory"), views)
