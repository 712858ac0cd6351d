"""Meshes and cameras of the geometry tests, all made by formula."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]


def icosphere(subdivisions: int) -> tuple[Positions, Faces]:
    """Unit sphere of 20·4ⁿ triangles, outward."""
    t = (1 + 5**0.5) / 2
    v = np.array(
        [
            [-1, t, 0],
            [1, t, 0],
            [-1, -t, 0],
            [1, -t, 0],
            [0, -1, t],
            [0, 1, t],
            [0, -1, -t],
            [0, 1, -t],
            [t, 0, -1],
            [t, 0, 1],
            [-t, 0, -1],
            [-t, 0, 1],
        ]
    )
    f = np.array(
        [
            [0, 11, 5],
            [0, 5, 1],
            [0, 1, 7],
            [0, 7, 10],
            [0, 10, 11],
            [1, 5, 9],
            [5, 11, 4],
            [11, 10, 2],
            [10, 7, 6],
            [7, 1, 8],
            [3, 9, 4],
            [3, 4, 2],
            [3, 2, 6],
            [3, 6, 8],
            [3, 8, 9],
            [4, 9, 5],
            [2, 4, 11],
            [6, 2, 10],
            [8, 6, 7],
            [9, 8, 1],
        ]
    )
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    for _ in range(subdivisions):
        edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = v[unique].sum(axis=1)
        number = len(v) + inverse.reshape(3, -1)
        v = np.concatenate([v, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        ab, bc, ca = number
        f = np.concatenate(
            [np.stack(c, 1) for c in ((f[:, 0], ab, ca), (ab, f[:, 1], bc), (ca, bc, f[:, 2]), (ab, bc, ca))]
        )
    return v, f


def bumpy_sphere(subdivisions: int, seed: int = 0) -> tuple[Positions, Faces]:
    """A sphere with bumps of many sizes: long inner contours, hidden folds."""
    v, f = icosphere(subdivisions)
    random = np.random.default_rng(seed)
    height = np.zeros(len(v))
    for frequency in (3, 6, 12, 24):
        for _ in range(6):
            direction = random.normal(size=3)
            direction /= np.linalg.norm(direction)
            height += np.sin(frequency * v @ direction + random.uniform(0, 2 * np.pi)) / frequency**0.7
    return v * (1 + 0.04 * height / height.std())[:, None], f


def torus(around: int = 48, tube: int = 24, small: float = 0.35) -> tuple[Positions, Faces]:
    """Its axis is z; radius 1 to the middle of the tube."""
    a, b = np.meshgrid(np.arange(around), np.arange(tube), indexing="ij")
    u, w = 2 * np.pi * a / around, 2 * np.pi * b / tube
    v = np.stack([(1 + small * np.cos(w)) * np.cos(u), (1 + small * np.cos(w)) * np.sin(u), small * np.sin(w)], -1)
    here = a * tube + b
    right, up = (a + 1) % around * tube + b, a * tube + (b + 1) % tube
    both = (a + 1) % around * tube + (b + 1) % tube
    f = np.concatenate(
        [np.stack([here, right, both], -1).reshape(-1, 3), np.stack([here, both, up], -1).reshape(-1, 3)]
    )
    return v.reshape(-1, 3), f


def camera(size: int, eye: tuple[float, float, float], focal: float = 1.4, height: int = 0) -> Camera:
    """Looks at the origin; `focal` in widths."""
    place = np.array(eye, dtype=float)
    z = -place / np.linalg.norm(place)
    x = np.cross(z, [0.0, 1.0, 0.0] if abs(z[1]) < 0.99 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ place
    height = height or size
    return Camera(
        np.array([[focal * size, 0, size / 2], [0, focal * size, height / 2], [0, 0, 1.0]]), pose, size, height
    )


def facing(size: int, pixels_per_unit: float = 1.0) -> Camera:
    """At z = −1 looking along +z: a point (x, y, 0) lands on pixel (x, y) · `pixels_per_unit`."""
    pose = np.eye(4)
    pose[2, 3] = 1.0
    k = np.diag([pixels_per_unit, pixels_per_unit, 1.0])
    return Camera(k, pose, size, size)


def mesh_of(positions: Positions, faces: Faces, dtype: torch.dtype = torch.float32, grad: bool = False) -> Mesh:
    tensor = torch.as_tensor(np.array(positions), dtype=dtype).reshape(-1, 3).clone().requires_grad_(grad)
    return Mesh(tensor, Topology(torch.as_tensor(np.array(faces, dtype=np.int64)).reshape(-1, 3)))


def targets_of(cameras: list[Camera], masks: list[NDArray[np.floating]] | None = None) -> SilhouetteTargets:
    """With masks that are full, where none are given."""
    masks = masks or [np.ones((c.height, c.width)) for c in cameras]
    return SilhouetteTargets(tuple(cameras), tuple(torch.as_tensor(m, dtype=torch.float32) for m in masks))


def around(count: int, size: int, radius: float = 3.2) -> list[Camera]:
    """Cameras on a sphere about the origin, spread by the golden angle."""
    cameras = []
    for i in range(count):
        height = 1 - 2 * (i + 0.5) / count
        ring, angle = (1 - height**2) ** 0.5, i * np.pi * (3 - 5**0.5)
        cameras.append(camera(size, (radius * ring * np.cos(angle), radius * height, radius * ring * np.sin(angle))))
    return cameras


class _Stored:
    def __init__(self, mask: NDArray[np.float32]) -> None:
        self.mask = mask

    def __call__(self) -> Pixels:
        return Pixels(np.zeros((*self.mask.shape, 3), np.float32), self.mask, np.zeros(self.mask.shape, bool))


def capture_of(positions: Positions, faces: Faces, cameras: list[Camera]) -> Capture:
    """Photographs' masks of a mesh: antialiased coverage of 8 lines a pixel."""
    renderer = Contour(ContourOptions(render_lines=8))
    views = []
    for i, view in enumerate(cameras):
        mask = renderer.render(mesh_of(positions, faces), [view])[0].numpy().astype(np.float32)
        views.append(View(f"{i:03}", view, _Stored(mask)))
    return Capture(Path("made"), tuple(views))


def smooth_directions(positions: Positions, count: int, seed: int = 5) -> list[Positions]:
    """Sums of eight plane waves of about the object's size."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        wave, push, phase = random.normal(size=(8, 3)), random.normal(size=(8, 3)), random.uniform(0, 2 * np.pi, 8)
        found.append(np.sin(2 * positions @ wave.T + phase) @ push / 3)
    return found
