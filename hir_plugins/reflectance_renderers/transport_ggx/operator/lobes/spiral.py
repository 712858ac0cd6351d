"""Points in the unit square for the directions of a lobe or of a hemisphere."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.run.determinism import folded_seed

TURN = (math.sqrt(5) - 1) / 2
"""Of a turn, from one direction of a lobe to the next: the inverse golden ratio."""


def spiral_points(count: int, samples: int, seed: int, device: torch.device) -> Float[Tensor, "P K 2"]:
    """Points (angle, area) in the unit square that are even on a disk: a Fibonacci spiral (Vogel 1979).

    Each pixel turns it and moves it along the radius at random, which decorrelates neighbours. Every ring of area
    1 / K has one point. The R2 sequence is even on the square instead, and lobes have 0.5 to 2 dB more error with it
    (docs/studies/directions_of_lobes.md).
    """
    index = torch.arange(samples, dtype=torch.float64)
    turned = (index * TURN).remainder(1).float().to(device)
    generator = torch.Generator().manual_seed(folded_seed(seed))
    shift = torch.rand(count, 1, 2, generator=generator, dtype=torch.float64).float().to(device)
    angle = turned + shift[..., 0]
    area = (index.float().to(device) + shift[..., 1]) / samples
    return torch.stack([torch.where(angle >= 1, angle - 1, angle), area], dim=-1)
