"""Meshes, cameras and directions that benchmarks and tests measure on, all by formula."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_core.testing.scenes import looking_at, smooth_sphere

Positions = NDArray[np.float64]
Faces = NDArray[np.int64]

EYES = ((3.0, 1.0, 0.5), (-1.0, 0.4, 3.2))


def bumpy_sphere(subdivisions: int, seed: int = 0) -> tuple[Positions, Faces]:
    """A sphere of 20·4ⁿ triangles with bumps of many sizes: long inner contours, hidden folds."""
    ball = smooth_sphere(subdivisions)
    v, f = ball.positions.double().numpy(), ball.faces.numpy()
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    random = np.random.default_rng(seed)
    height = np.zeros(len(v))
    for frequency in (3, 6, 12, 24):
        for _ in range(6):
            direction = random.normal(size=3)
            direction /= np.linalg.norm(direction)
            height += np.sin(frequency * v @ direction + random.uniform(0, 2 * np.pi)) / frequency**0.7
    return v * (1 + 0.04 * height / height.std())[:, None], f


def mesh_of(positions: Positions, faces: Faces, grad: bool = False) -> Mesh:
    """float32, whose positions may ask for gradients."""
    tensor = torch.from_numpy(np.asarray(positions, np.float32).copy()).requires_grad_(grad)
    return Mesh(tensor, Topology(torch.from_numpy(np.asarray(faces, np.int64))))


def cameras(size: int) -> list[Camera]:
    """Two, from either side."""
    return [looking_at(eye, size, 1.4) for eye in EYES]


def full_targets(views: list[Camera]) -> SilhouetteTargets:
    """Masks that cover the whole frame."""
    return SilhouetteTargets(tuple(views), tuple(torch.ones(c.height, c.width) for c in views))


def smooth_directions(positions: Positions, count: int, seed: int = 5) -> list[Positions]:
    """Ways to move a mesh: sums of eight plane waves of about the object's size."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        wave, push, phase = random.normal(size=(8, 3)), random.normal(size=(8, 3)), random.uniform(0, 2 * np.pi, 8)
        found.append(np.sin(2 * positions @ wave.T + phase) @ push / 3)
    return found
