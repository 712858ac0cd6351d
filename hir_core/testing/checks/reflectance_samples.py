"""What contracts of reflectance renderers look at: cameras without photographs, pixels, means over seeds."""

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
