"""A tiny synthetic capture whose truth is known: two coloured balls before a plain wall, rendered by formula."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, OrientedPoints, Pixels, View

if TYPE_CHECKING:
    from hir_core.scene import Scene

BALLS = ((np.array([0.0, 0.0, 0.0]), 1.0), (np.array([0.55, 0.8, 0.35]), 0.5))
"""Centres and radii: no symmetry, so a flipped axis shows."""

WALL_SRGB = np.array([30.0, 60.0, 160.0]) / 255
SUPERSAMPLES = 4


@dataclass(frozen=True)
class StoredPixels:
    """Pixels that are already in memory; picklable, as `View.read` must be."""

    color_linear: NDArray[np.float32]
    mask: NDArray[np.float32] | None

    def __call__(self) -> Pixels:
        return Pixels(self.color_linear, self.mask, np.zeros(self.color_linear.shape[:2], dtype=bool))


@dataclass(frozen=True)
class TinyCapture:
    """The truth. The world is ours: right-handed, +Y up; the object is centred near the origin, its radius about 1."""

    folder: Path
    """Holds the photographs as 8-bit PNG without alpha, `images/00.png` and so on."""
    capture: Capture
    """Views with cameras and masks, and oriented points of the surface."""

    def without_masks(self) -> Capture:
        """The capture as photographs alone show it; cameras and points stay."""
        views = [replace(v, read=StoredPixels(v.read().color_linear, None)) for v in self.capture.views]
        return replace(self.capture, views=tuple(views))

    def without_cameras(self) -> Capture:
        """Photographs with masks and nothing else."""
        return replace(self.capture, views=tuple(replace(v, camera=None) for v in self.capture.views), points=None)

    @property
    def masks(self) -> list[NDArray[np.float32]]:
        """The true coverage of each view."""
        found = [view.read().mask for view in self.capture.views]
        return [mask for mask in found if mask is not None]


def tiny_capture(folder: Path, views: int = 8, size: int = 64, detail: float = 3.0) -> TinyCapture:
    """Photographs from all around, written to `folder/images`; `detail` is the finest frequency of the colours."""
    made = []
    for i in range(views):
        same, color, mask = _numbered_photograph(i, size, detail)
        camera, color, mask = deepcopy(same), color.copy(), mask.copy()
        path = folder / "images" / f"{i:02}.png"
        write_png(path, linear_to_srgb(color).astype(np.float32))
        made.append(View(path.stem, camera, StoredPixels(color, mask), path=path))
    return TinyCapture(folder, Capture(folder, tuple(made), points=surface_points()))


@lru_cache(maxsize=64)
def _numbered_photograph(
    number: int, size: int, detail: float
) -> tuple[Camera, NDArray[np.float32], NDArray[np.float32]]:
    """Camera, colour and coverage; most contracts use the same few photographs."""
    angle, height = 2 * np.pi * (number * 0.618034), 1.7 * np.sin(2.4 * number + 0.5)
    ring = np.sqrt(3.4**2 - height**2)
    camera = _camera(np.array([ring * np.cos(angle), height, ring * np.sin(angle)]), size)
    return camera, *_photograph(camera, detail)


def distance_to_surface(points: Array) -> Array:
    """Signed distance (N,) to the true surface where it is nearest, negative inside."""
    return np.min([np.linalg.norm(points - centre, axis=1) - radius for centre, radius in BALLS], axis=0)


def surface_points(count: int = 3000) -> OrientedPoints:
    """Points of the true surface, with normals and colours."""
    random = np.random.default_rng(0)
    positions, normals = [], []
    for centre, radius in BALLS:
        direction = random.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        positions.append(centre + radius * direction)
        normals.append(direction)
    position, normal = np.concatenate(positions), np.concatenate(normals)
    outside = distance_to_surface(position) > -1e-9
    return OrientedPoints(position[outside], normal[outside], _color(position[outside], 3.0))


def surface_mesh(cells: int = 64) -> Scene:
    """The true surface as one closed mesh."""
    import torch
    from skimage.measure import marching_cubes

    from hir_core.scene import Mesh, Scene, Topology

    low = np.min([np.subtract(centre, radius) for centre, radius in BALLS], axis=0) - 0.1
    high = np.max([np.add(centre, radius) for centre, radius in BALLS], axis=0) + 0.1
    axes = [np.linspace(*ends, cells) for ends in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distance = distance_to_surface(points.reshape(-1, 3)).reshape(points.shape[:3])
    spacing = tuple((high - low) / (cells - 1))
    positions, faces, _, _ = marching_cubes(distance, 0.0, spacing=spacing)
    vertices = torch.from_numpy((positions + low).astype(np.float32))
    return Scene(Mesh(vertices, Topology(torch.from_numpy(faces.astype(np.int64)))))


def similarity_between(source: Array, target: Array) -> tuple[Array, float]:
    """The 4×4 similarity that brings points (N, 3) onto others best, and the largest distance that is left (Umeyama
    1991). A mirrored world leaves a large one.
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a / len(a))
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    scale = float((s * np.diag(sign)).sum() / max((a**2).sum() / len(a), 1e-30))
    transform = np.eye(4)
    transform[:3, :3] = scale * rotation
    transform[:3, 3] = target.mean(axis=0) - scale * rotation @ source.mean(axis=0)
    moved = source @ transform[:3, :3].T + transform[:3, 3]
    return transform, float(np.linalg.norm(moved - target, axis=1).max())


def _camera(eye: Array, size: int) -> Camera:
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    # aimed a little above the origin, at the middle of both balls
    pose[:3, 3] = -pose[:3, :3] @ (eye + np.array([0.1, 0.2, 0.05]))
    focal = 1.05 * size
    return Camera(np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]), pose, size, size)


def _photograph(camera: Camera, detail: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Linear colour (H W 3), quantised as an 8-bit file is, and true coverage (H W)."""
    steps = (np.arange(camera.width * SUPERSAMPLES) + 0.5) / SUPERSAMPLES
    x, y = np.meshgrid(steps, steps)
    origin, direction = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    reach = np.full(len(origin), np.inf)
    for centre, radius in BALLS:
        offset = origin - centre
        half = (offset * direction).sum(axis=1)
        root = half**2 - (offset**2).sum(axis=1) + radius**2
        hit = root > 0
        reach[hit] = np.minimum(reach[hit], -half[hit] - np.sqrt(root[hit]))
    seen = np.isfinite(reach)
    color = np.tile(srgb_to_linear(WALL_SRGB), (len(origin), 1))
    color[seen] = _color(origin[seen] + reach[seen, None] * direction[seen], detail)
    shape = (camera.height, SUPERSAMPLES, camera.width, SUPERSAMPLES)
    mean = color.reshape(*shape, 3).mean(axis=(1, 3))
    quantised = np.rint(linear_to_srgb(mean) * 255) / 255
    return srgb_to_linear(quantised).astype(np.float32), seen.reshape(shape).mean(axis=(1, 3)).astype(np.float32)


def _color(points: Array, detail: float) -> Array:
    """A solid texture of warm colours, far from the wall's blue."""
    waves = np.random.default_rng(7).normal(size=(24, 3))
    waves *= (np.geomspace(1, detail, 24) * 2 / np.linalg.norm(waves, axis=1))[:, None]
    phase = np.random.default_rng(8).uniform(0, 2 * np.pi, 24)
    value = np.sin(points @ waves.T + phase)
    blend = 0.5 + 0.5 * np.tanh(value @ np.random.default_rng(9).normal(size=(24, 2)) / 2)
    red, green = 0.35 + 0.5 * blend[:, 0], 0.15 + 0.5 * blend[:, 1]
    return np.stack([red, green, 0.05 + 0.05 * blend[:, 0]], axis=1)
