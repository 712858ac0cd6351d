"""Meshes, cameras and displacements for benchmarks and tests, all defined by formulas."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_core.testing.scenes import looking_at, smooth_sphere

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

CAMERA_POSITIONS: Final = ((3.0, 1.0, 0.5), (-1.0, 0.4, 3.2))


def bumpy_sphere(subdivisions: int, seed: int = 0) -> tuple[Positions, Faces]:
    """Positions (V, 3) and faces (F, 3) of a sphere of 20·4ⁿ triangles with bumps of many sizes.

    Its outline has long inner contours and hidden folds.
    """
    sphere = smooth_sphere(subdivisions)
    positions, faces = sphere.positions.double().numpy(), sphere.faces.numpy()
    positions = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    random = np.random.default_rng(seed)
    height = np.zeros(len(positions))
    for frequency in (3, 6, 12, 24):
        for _ in range(6):
            direction = random.normal(size=3)
            direction /= np.linalg.norm(direction)
            height += np.sin(frequency * positions @ direction + random.uniform(0, 2 * np.pi)) / frequency**0.7
    return positions * (1 + 0.04 * height / height.std())[:, None], faces


def bowl(rings: int = 24, sections: int = 48, depth: float = 0.9, wall: float = 0.1) -> Mesh:
    """A closed thick-walled bowl that opens upwards: a half ellipsoid of radius 1 − `wall` and of `depth` inside.

    Its outer wall is the lower unit hemisphere. 4·`rings`·`sections` triangles.
    """
    polar = np.linspace(0, np.pi / 2, rings + 1)
    inner = 1 - wall
    # from the outer pole up to the rim, over it, and down to the inner pole
    outside = np.stack([np.sin(polar), -np.cos(polar)], axis=1)
    inside = np.stack([inner * np.sin(polar), -depth * np.cos(polar)], axis=1)[::-1]
    profile = np.concatenate([outside, inside])
    azimuth = 2 * np.pi * np.arange(sections) / sections
    circles = profile[1:-1]
    around = np.stack(
        [
            circles[:, None, 0] * np.sin(azimuth),
            np.broadcast_to(circles[:, 1:], (len(circles), sections)),
            circles[:, None, 0] * np.cos(azimuth),
        ],
        axis=-1,
    ).reshape(-1, 3)
    low, high = np.array([[0.0, -1.0, 0.0]]), np.array([[0.0, -depth, 0.0]])
    positions = np.concatenate([around, low, high])
    first, last = len(around), len(around) + 1
    row, column = np.meshgrid(np.arange(len(circles) - 1), np.arange(sections), indexing="ij")
    a, b = row * sections + column, row * sections + (column + 1) % sections
    c, d = a + sections, b + sections
    walls = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    here, then = np.arange(sections), (np.arange(sections) + 1) % sections
    rim = (len(circles) - 1) * sections
    bottom = np.stack([np.full(sections, first), then, here], -1)
    floor = np.stack([np.full(sections, last), rim + here, rim + then], -1)
    return make_mesh(positions, np.concatenate([walls, bottom, floor]))


def make_mesh(positions: Positions, faces: Faces, requires_grad: bool = False) -> Mesh:
    """A float32 mesh."""
    tensor = torch.from_numpy(np.asarray(positions, np.float32).copy()).requires_grad_(requires_grad)
    return Mesh(tensor, Topology(torch.from_numpy(np.asarray(faces, np.int64))))


def bench_cameras(size: int) -> list[Camera]:
    """Two cameras on different sides, with images of size²."""
    return [looking_at(position, size, 1.4) for position in CAMERA_POSITIONS]


def full_frame_targets(cameras: list[Camera]) -> SilhouetteTargets:
    """Masks that cover the whole frame."""
    return SilhouetteTargets(tuple(cameras), tuple(torch.ones(c.height, c.width) for c in cameras))


def smooth_displacements(positions: Positions, count: int, seed: int = 5) -> list[Positions]:
    """Displacement fields (V, 3): sums of eight plane waves whose length is about the object's size."""
    random = np.random.default_rng(seed)
    fields = []
    for _ in range(count):
        wave, amplitude, phase = random.normal(size=(8, 3)), random.normal(size=(8, 3)), random.uniform(0, 2 * np.pi, 8)
        fields.append(np.sin(2 * positions @ wave.T + phase) @ amplitude / 3)
    return fields
