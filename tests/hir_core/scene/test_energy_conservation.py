"""A surface gives back no more light than it gets."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hir_core.scene import Material
from hir_core.scene.energy_conservation import specular_at_size_of, with_conserved_energy


def material(model: str, diffuse: object, specular: object) -> Material:
    as_tensor = [torch.as_tensor(v, dtype=torch.float32) for v in (diffuse, specular)]
    return Material(model, *as_tensor, torch.tensor([0.3]))  # type: ignore[arg-type]


def test_white_and_glossy_at_once_gives_back_what_it_got() -> None:
    guarded, changed = with_conserved_energy(material("paper", [0.9, 0.5, 1.2], [0.3, 0.3, 0.3]))
    np.testing.assert_allclose(guarded.diffuse_albedo, [0.7, 0.5, 0.7], atol=1e-6)
    np.testing.assert_allclose(guarded.specular_albedo, 0.3)
    assert changed == pytest.approx(2 / 3)


def test_a_coupled_diffuse_part_keeps_both_albedos() -> None:
    guarded, changed = with_conserved_energy(material("dielectric", [0.9, 0.9, 0.9], [0.9, 0.9, 0.9]))
    np.testing.assert_allclose(guarded.diffuse_albedo, 0.9)
    assert changed == 0


@pytest.mark.parametrize("diffuse", [(8, 8, 3), (3,)])
@pytest.mark.parametrize("specular", [(4, 4, 3), (8, 8, 3), (3,)])
def test_maps_of_any_size_and_values_that_are_none(diffuse: tuple[int, ...], specular: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(0)
    rho_d, rho_s = (3 * torch.rand(shape, generator=generator) - 1 for shape in (diffuse, specular))
    rho_d.view(-1)[0], rho_s.view(-1)[0] = torch.nan, torch.inf
    guarded, _ = with_conserved_energy(material("paper", rho_d, rho_s))
    for value in (guarded.diffuse_albedo, guarded.specular_albedo):
        assert bool(torch.isfinite(value).all()) and float(value.min()) >= 0 and float(value.max()) <= 1
    assert guarded.diffuse_albedo.shape == diffuse and guarded.specular_albedo.shape == specular
    if diffuse == specular:
        assert float((guarded.diffuse_albedo + guarded.specular_albedo).max()) <= 1 + 1e-6


def test_a_map_that_changed_in_one_texel_says_so() -> None:
    rho_d = torch.full((4, 4, 3), 0.5)
    rho_d[1, 2, 0], rho_d[3, 3, 1] = 0.8, torch.nan
    guarded, changed = with_conserved_energy(material("paper", rho_d, [0.3, 0.3, 0.3]))
    assert changed == pytest.approx(2 / 48)
    assert float(guarded.diffuse_albedo[1, 2, 0]) == pytest.approx(0.7) and float(guarded.diffuse_albedo[3, 3, 1]) == 0
    nearly, changed = with_conserved_energy(material("paper", torch.full((4, 4, 3), 0.7000005), [0.3, 0.3, 0.3]))
    assert changed == 0, "what rounding leaves is no change"
    assert guarded.model == nearly.model == "paper" and guarded.roughness.tolist() == pytest.approx([0.3])


def test_what_is_infinite_or_negative_ends_at_the_ends() -> None:
    guarded, _ = with_conserved_energy(material("dielectric", [torch.inf, -torch.inf, -1.0], [torch.nan, 2.0, 0.5]))
    assert guarded.diffuse_albedo.tolist() == [1.0, 0.0, 0.0] and guarded.specular_albedo.tolist() == [0.0, 1.0, 0.5]


def test_a_specular_map_is_brought_to_the_diffuse_ones_size() -> None:
    ramp = torch.linspace(0, 1, 4)[None, :, None].expand(4, 4, 3)
    large = specular_at_size_of(ramp, torch.zeros(8, 16, 3))
    assert large.shape == (8, 16, 3)
    # texel centres: the first lies 3/8 of a texel left of the coarse map's first centre, and stays at its value
    torch.testing.assert_close(large[0, :4, 0], torch.tensor([0.0, 0.0, 1 / 24, 1 / 8]))
    torch.testing.assert_close(large[:, 8], large[:1, 8].expand(8, 3))
    same = torch.rand(8, 16, 3)
    assert specular_at_size_of(same, torch.zeros(8, 16, 3)) is same
    constant = torch.tensor([0.1, 0.2, 0.3])
    assert specular_at_size_of(constant, torch.zeros(8, 16, 3)) is constant


def test_one_diffuse_colour_under_a_map_is_held_by_its_brightest_texel() -> None:
    rho_s = torch.full((4, 4, 3), 0.1)
    rho_s[2, 1] = torch.tensor([0.9, 0.2, 0.6])
    guarded, changed = with_conserved_energy(material("paper", [0.5, 0.5, 0.5], rho_s))
    torch.testing.assert_close(guarded.diffuse_albedo, torch.tensor([0.1, 0.5, 0.4]))
    assert changed == pytest.approx(2 / 3)
