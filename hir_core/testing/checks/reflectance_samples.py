"""What contracts of reflectance renderers look at: scenes, cameras without photographs, pixels, means over seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hir_core.testing.contract import Subject
from hir_core.testing.exercise import seeded

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.capture import Camera, Capture
    from hir_core.plugins.interfaces import PreparedReflectance
    from hir_core.scene import EnvironmentMap, Material, Mesh, Scene

SIZE = 24
FEW, MANY = 4, 16
"""Repetitions of what is stochastic."""


def capture_of(cameras: Sequence[Camera]) -> Capture:
    """Black photographs of these cameras, whose masks are full."""
    from hir_core.capture import Capture, View
    from hir_core.testing.captures import StoredPixels

    views = []
    for i, camera in enumerate(cameras):
        shape = (camera.height, camera.width)
        views.append(View(str(i), camera, StoredPixels(np.zeros((*shape, 3), np.float32), np.ones(shape, np.float32))))
    return Capture(Path("made"), tuple(views))


def pixel_grid(size: int = SIZE, step: int = 1) -> Tensor:
    """View 0, x and y (N, 3) of the pixels of a square picture."""
    import torch

    y, x = torch.meshgrid(torch.arange(0, size, step), torch.arange(0, size, step), indexing="ij")
    return torch.stack([torch.zeros_like(x), x, y], dim=-1).reshape(-1, 3)


def mean_over_seeds(subject: Subject, value: Callable[[], Tensor], times: int = FEW) -> tuple[Tensor, Tensor]:
    """Mean and its standard error over runs of different seeds; one run and 0 where nothing is stochastic."""
    import torch

    if not subject.has("stochastic"):
        seeded(0)
        one = value().detach()
        return one, torch.zeros_like(one)
    runs = []
    for seed in range(times):
        seeded(seed)
        runs.append(value().detach())
    stacked = torch.stack(runs).double()
    return stacked.mean(0), stacked.std(0) / np.sqrt(times)


def sphere_scene(material: Material, light: EnvironmentMap, mesh: Mesh | None = None) -> Scene:
    """A sphere of radius 1, or another mesh, in a light."""
    from hir_core.scene import Scene
    from hir_core.testing.scenes import smooth_sphere

    return Scene(mesh or smooth_sphere(4), material, light)


def prepared_for(subject: Subject, scene: Scene, camera: Camera) -> PreparedReflectance:
    """The renderer of the subject, prepared for a scene and one camera."""
    found: PreparedReflectance = subject.create().prepare(scene, capture_of([camera]))
    return found


def ball_normals(pixels: Tensor, cameras: Sequence[Camera]) -> np.ndarray:
    """Normals (B, 3) of a sphere of radius 1 at the origin in pixels (B, 3): view, x, y; NaN beside the sphere."""
    normals = np.full((len(pixels), 3), np.nan)
    for i, camera in enumerate(cameras):
        chosen = (pixels[:, 0] == i).numpy()
        origin, direction = camera.rays(pixels[chosen, 1:].numpy() + 0.5)
        half = (origin * direction).sum(axis=1)
        root = half**2 - (origin**2).sum(axis=1) + 1
        reach = -half - np.sqrt(np.where(root > 0, root, np.nan))
        normals[chosen] = origin + reach[:, None] * direction
    return normals


def spot_light(direction: np.ndarray, rows: int, sharpness: float = 150.0) -> Tensor:
    """A lobe of light around a direction: 5° wide (standard deviation), or 13° with a sharpness of 20."""
    import torch
    from hir_exporters.conventions import latlong_directions

    cosine = latlong_directions(rows, 2 * rows) @ direction
    return torch.from_numpy(np.exp(sharpness * (cosine - 1)))[..., None].expand(-1, -1, 3).float().contiguous()
