"""The light as a pyramid of lat-long images, which `traced_directions` reads.

A sample that represents a cone of directions reads the level whose texels are about as large as the cone, so a wide
lobe needs few samples (filtered importance sampling, Křivánek & Colbert 2008). Every level is a linear function of the
finest, so the whole transport stays linear in the light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Pyramid:
    """Sizes and offsets of the levels of a lat-long image of `height`×`width`."""

    height: int
    width: int
    smallest: int = 2

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """(H, W) of each level, finest first."""
        shapes = [(self.height, self.width)]
        while shapes[-1][0] % 2 == 0 and shapes[-1][1] % 2 == 0 and shapes[-1][0] > self.smallest:
            shapes.append((shapes[-1][0] // 2, shapes[-1][1] // 2))
        return shapes

    @property
    def texels(self) -> int:
        """Texels of all levels together."""
        return sum(h * w for h, w in self.shapes)

    def flatten(self, radiance: Float[Tensor, "H W C"]) -> Float[Tensor, "T C"]:
        """All levels in one array, finest first; each texel is the solid-angle mean of the four finer ones."""
        levels = [radiance]
        for height, width in self.shapes[1:]:
            finer = levels[-1]
            weight = row_solid_angles(2 * height, finer.dtype, finer.device).reshape(height, 2)
            weight = weight / weight.sum(dim=1, keepdim=True)
            blocks = finer.reshape(height, 2, width, 2, -1).mean(dim=3)
            levels.append((blocks * weight[:, :, None, None]).sum(dim=1))
        return torch.cat([level.reshape(-1, radiance.shape[-1]) for level in levels])


def texel_directions(height: int, width: int) -> Float[Tensor, "T 3"]:
    """Unit directions of all texel centres, row by row."""
    v = (torch.arange(height, dtype=torch.float64) + 0.5) / height
    u = (torch.arange(width, dtype=torch.float64) + 0.5) / width
    theta, phi = torch.meshgrid(v * math.pi, (0.5 - u) * 2 * math.pi, indexing="ij")
    directions = torch.stack([theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos()], dim=-1)
    return directions.reshape(-1, 3).float()


def row_solid_angles(height: int, dtype: torch.dtype, device: torch.device) -> Float[Tensor, " H"]:
    """Share of the sphere that each row of a lat-long image covers; sums to 1."""
    edges = torch.cos(torch.linspace(0, math.pi, height + 1, dtype=torch.float64))
    return ((edges[:-1] - edges[1:]) / 2).to(dtype).to(device)


def resized(radiance: Float[Tensor, "h w C"], pyramid: Pyramid) -> Float[Tensor, "H W C"]:
    """A light at the pyramid's size; reduced by area averages, so that a sun keeps its energy. Differentiable."""
    height, width, _ = radiance.shape
    if (height, width) == (pyramid.height, pyramid.width):
        return radiance
    image = radiance.permute(2, 0, 1)[None]
    if height >= pyramid.height and width >= pyramid.width:
        image = torch.nn.functional.adaptive_avg_pool2d(image, (pyramid.height, pyramid.width))
    else:
        image = torch.nn.functional.interpolate(image, (pyramid.height, pyramid.width), mode="bilinear")
    return image[0].permute(1, 2, 0)
