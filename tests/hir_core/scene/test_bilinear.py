"""The bilinear lookup against torch's own `grid_sample`, and its border rules."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import grid_sample

from hir_core.scene.bilinear import (
    Border,
    axis_neighbours,
    bilinear_values,
    bilinear_weights,
    texture_texels,
)


def test_a_texture_lookup_is_that_of_grid_sample() -> None:
    generator = torch.Generator().manual_seed(0)
    image, uv = torch.rand(5, 8, 3, generator=generator), torch.rand(500, 2, generator=generator)
    index, weight = texture_texels(uv, 5, 8)
    value = (image.reshape(-1, 3)[index] * weight[..., None]).sum(dim=1)
    expected = grid_sample(
        image.permute(2, 0, 1)[None], uv[None, None] * 2 - 1, padding_mode="border", align_corners=False
    )
    assert torch.allclose(value, expected[0, :, 0].T, atol=1e-6)


@pytest.mark.parametrize(
    ("border", "position", "low", "high", "fraction"),
    [
        ("repeat", -0.25, 7, 0, 0.75),
        ("repeat", 7.25, 7, 0, 0.25),
        ("clamp", -0.25, 0, 1, 0.0),
        ("clamp", 7.25, 6, 7, 1.0),
        ("extend", -0.25, 0, 0, 0.75),
        ("extend", 7.25, 7, 7, 0.25),
    ],
)
def test_border_rules(border: Border, position: float, low: int, high: int, fraction: float) -> None:
    found = axis_neighbours(torch.tensor([position]), 8, border)
    assert (found.low.item(), found.high.item(), found.fraction.item()) == (low, high, fraction)


def test_an_axis_of_one_texel_has_only_that() -> None:
    for border in ("repeat", "clamp", "extend"):
        found = axis_neighbours(torch.tensor([-0.5, 0.0, 0.5]), 1, border)  # type: ignore[arg-type]
        assert found.low.tolist() == found.high.tolist() == [0, 0, 0]


def test_values_are_those_of_the_weights_and_exact_for_a_constant_image() -> None:
    generator = torch.Generator().manual_seed(0)
    position = torch.rand(500, 2, generator=generator) * torch.tensor([7.0, 4.0])
    x, y = axis_neighbours(position[:, 0], 8, "clamp"), axis_neighbours(position[:, 1], 5, "clamp")
    image = torch.rand(40, 3, generator=generator)
    index, weight = bilinear_weights(x, y, 8)
    assert torch.allclose(bilinear_values(image, x, y, 8), (image[index] * weight[..., None]).sum(dim=1), atol=1e-6)
    assert bool((bilinear_values(torch.full((40, 3), 0.3), x, y, 8) == torch.tensor(0.3)).all())
