"""Bilateral smoothness and total variation: definition, gradients, cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hir_exporters.conventions import direction_to_latlong_uv

from hir_core.atlas import unwrap_mesh
from hir_core.errors import ConfigError
from hir_core.scene import EnvironmentMap, Material, Scene, Topology
from hir_plugins.regularizers.bilateral_specular import BilateralSpecular, all_pairs, neighbour_sum, neighbourhoods
from hir_plugins.regularizers.material_options import BilateralSpecularOptions, TotalVariationOptions
from hir_plugins.regularizers.places import places_of
from hir_plugins.regularizers.total_variation import TotalVariation, environment_variation, texture_variation

from .shapes import bumpy_sphere, square


def textured(subdivisions: int = 2, size: int = 16, dtype: torch.dtype = torch.float64) -> Scene:
    """Two diffuse colours with noise, specular noise."""
    torch.manual_seed(0)
    mesh = bumpy_sphere(subdivisions)
    uvs = torch.from_numpy(direction_to_latlong_uv(mesh.positions.numpy())).float()
    mesh = replace(mesh, uvs=uvs, topology=Topology(mesh.faces, mesh.faces))
    stripes = (torch.arange(size) // 4 % 2).to(dtype)[None, :, None] * 0.4 + 0.3
    diffuse = stripes + 0.05 * torch.rand(size, size, 3, dtype=dtype)
    specular = 0.04 + 0.2 * torch.rand(size, size, 3, dtype=dtype)
    return Scene(mesh, Material("paper", diffuse, specular, torch.full((1,), 0.3, dtype=dtype)))


def definition(positions: np.ndarray, diffuse: np.ndarray, specular: np.ndarray, s1: float, s2: float) -> float:
    """METHOD: a loop over p, nothing shared with the code."""
    total = 0.0
    for p in range(len(positions)):
        k = np.exp(-((positions[p] - positions) ** 2).sum(1) / (2 * s1**2)
                   - ((diffuse[p] - diffuse) ** 2).sum(1) / (2 * s2**2))
        total += np.abs(specular[p] - (k[:, None] * specular).sum(0) / k.sum()).sum()
    return total


def with_maps(scene: Scene, diffuse: torch.Tensor, specular: torch.Tensor) -> Scene:
    assert scene.material is not None
    return replace(scene, material=replace(scene.material, diffuse_albedo=diffuse, specular_albedo=specular))


@pytest.mark.parametrize("places", ["vertices", "texels"])
def test_bilateral_is_the_papers_sum(places: str) -> None:
    scene = textured()
    assert scene.material is not None
    options = BilateralSpecularOptions(0.1, 0.2, places, "all_pairs")  # type: ignore[arg-type]
    value = float(BilateralSpecular(options).prepare(scene)(scene))
    spots = places_of(scene.mesh, places, (16, 16))  # type: ignore[arg-type]
    positions = spots.positions.double().numpy()
    diagonal = float(np.linalg.norm(positions.max(0) - positions.min(0)))
    maps = [spots.values(m).numpy() for m in (scene.material.diffuse_albedo, scene.material.specular_albedo)]
    # places are float32
    assert value == pytest.approx(definition(positions, maps[0], maps[1], 0.1 * diagonal, 0.2), rel=1e-5)


@pytest.mark.parametrize("method", ["all_pairs", "neighbours"])
def test_bilateral_gradients_match_finite_differences(method: str) -> None:
    """Central differences in float64 along random directions, to ρs and to ρd."""
    scene = textured()
    assert scene.material is not None
    energy = BilateralSpecular(BilateralSpecularOptions(0.1, 0.2, "vertices", method, neighbours=0)).prepare(scene)  # type: ignore[arg-type]
    diffuse, specular = scene.material.diffuse_albedo, scene.material.specular_albedo
    for which in (0, 1):
        leaves = [diffuse.clone().requires_grad_(), specular.clone().requires_grad_()]
        gradient = torch.autograd.grad(energy(with_maps(scene, *leaves)), leaves)[which]
        direction = torch.randn(gradient.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(which))
        sides = []
        for sign in (1, -1):
            maps = [diffuse, specular]
            maps[which] = maps[which] + sign * 1e-7 * direction
            sides.append(float(energy(with_maps(scene, *maps))))
        assert float(gradient.abs().max()) > 1e-3
        assert float((gradient * direction).sum()) == pytest.approx((sides[0] - sides[1]) / 2e-7, rel=1e-5)


def test_error_of_the_neighbourhood_against_all_pairs() -> None:
    """Value, and both gradients as vectors, on 2562 vertices of white noise: the figures of the options' docstring."""
    scene = textured(4, 64)  # larger than the reach of the kernel
    assert scene.material is not None
    spots = places_of(scene.mesh, "vertices", (64, 64))
    positions = spots.positions / (0.05 * (spots.positions.amax(0) - spots.positions.amin(0)).norm())
    leaves = [
        (spots.values(scene.material.diffuse_albedo) / 0.1).requires_grad_(),
        spots.values(scene.material.specular_albedo).requires_grad_(),
    ]
    exact = all_pairs(positions, *leaves)
    exact_gradients = torch.autograd.grad(exact, leaves)
    for cutoff, in_value, in_gradient in ((3.0, 2e-3, 0.08), (4.0, 1e-4, 0.025)):
        value = neighbour_sum(neighbourhoods(positions, cutoff, 0), *leaves)
        assert abs(float((value / exact).detach()) - 1) < in_value
        for found, true in zip(torch.autograd.grad(value, leaves), exact_gradients, strict=True):
            assert float((found - true).norm() / true.norm()) < in_gradient
    value = neighbour_sum(neighbourhoods(positions, 3.0, 64), *leaves)
    assert abs(float((value / exact).detach()) - 1) < 0.05


def test_bilateral_ignores_what_is_flat_and_respects_edges_of_colour() -> None:
    scene = textured()
    assert scene.material is not None
    energy = BilateralSpecular(BilateralSpecularOptions(0.1, 0.05)).prepare(scene)
    flat = torch.full((16, 16, 3), 0.04, dtype=torch.float64, requires_grad=True)
    value = energy(with_maps(scene, scene.material.diffuse_albedo, flat))
    assert float(value) == 0
    assert float(torch.autograd.grad(value, flat)[0].abs().max()) == 0
    # specular that follows the diffuse stripes costs little; the same stripes on one diffuse colour cost much
    stripes = (torch.arange(16) // 4 % 2).double()[None, :, None].expand(16, 16, 3)
    follows = float(energy(with_maps(scene, stripes * 0.4 + 0.3, stripes * 0.2)))
    alone = float(energy(with_maps(scene, torch.full_like(stripes, 0.5), stripes * 0.2)))
    assert follows < 0.3 * alone


def test_a_constant_specular_costs_nothing() -> None:
    scene = textured()
    assert scene.material is not None
    look = replace(scene.material, specular_albedo=torch.full((3,), 0.04, requires_grad=True))
    constant = replace(scene, material=look)
    value = BilateralSpecular(BilateralSpecularOptions()).prepare(constant)(constant)
    assert float(value) == 0
    value.backward()


def test_with_a_limit_bilateral_time_grows_linearly() -> None:
    """Pairs, not seconds: sixteen times the places have sixteen times the pairs."""
    counts = []
    for subdivisions in (3, 5):
        positions = bumpy_sphere(subdivisions).positions / 0.2
        counts.append(neighbourhoods(positions, 3.0, 32).index.numel())
    assert counts[1] < 17 * counts[0]


def test_bilateral_over_texels_of_an_atlas_stays_finite() -> None:
    mesh, _ = unwrap_mesh(bumpy_sphere(3), 64)
    diffuse, specular = torch.zeros(64, 64, 3, requires_grad=True), torch.rand(64, 64, 3, requires_grad=True)
    scene = Scene(mesh, Material("dielectric", diffuse, specular, torch.ones(1)))
    value = BilateralSpecular(BilateralSpecularOptions(places="texels", average=True)).prepare(scene)(scene)
    assert torch.isfinite(value)
    for gradient in torch.autograd.grad(value, (diffuse, specular)):
        assert torch.isfinite(gradient).all()


def test_too_many_neighbours_are_named() -> None:
    crowd = torch.rand(20_000, 3)
    with pytest.raises(ConfigError, match="20000 places"):
        neighbourhoods(crowd, 3.0, 0)


def test_wrong_widths_are_named() -> None:
    with pytest.raises(ConfigError, match="sigma_albedo"):
        BilateralSpecular(BilateralSpecularOptions(sigma_albedo=0.0))


def test_total_variation_of_a_step_is_its_height_times_its_length() -> None:
    texture = torch.zeros(8, 16, 1)
    texture[:, 8:] = 0.5
    everything = torch.ones(8, 16, dtype=torch.bool)
    assert float(texture_variation(texture, everything)) == pytest.approx(0.5)
    fine = texture.repeat_interleave(4, 0).repeat_interleave(4, 1)
    assert float(texture_variation(fine, torch.ones(32, 64, dtype=torch.bool))) == pytest.approx(0.5)
    everything[:, 8] = False
    assert float(texture_variation(texture, everything)) == 0, "charts that do not touch are not compared"


def test_total_variation_of_a_half_lit_sky_is_its_horizon() -> None:
    """A step of 1 in three channels along a great circle of length 2π, whichever way the sky is cut."""
    upper, side = torch.zeros(32, 64, 3), torch.zeros(32, 64, 3)
    upper[:16], side[:, 10:42] = 1, 1
    assert float(environment_variation(upper)) == pytest.approx(3 * 2 * np.pi, rel=1e-5)
    assert float(environment_variation(side)) == pytest.approx(3 * 2 * np.pi, rel=1e-5)


def test_total_variation_gradients_match_finite_differences() -> None:
    torch.manual_seed(0)
    look = Material("paper", torch.rand(8, 8, 3).double(), torch.rand(8, 8, 3).double(), torch.rand(4, 4, 1).double())
    scene = Scene(square(), look, EnvironmentMap(torch.rand(4, 8, 3).double()))
    energy = TotalVariation(TotalVariationOptions(environment=0.5)).prepare(scene)

    def value(diffuse: torch.Tensor, roughness: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        there = replace(look, diffuse_albedo=diffuse, roughness=roughness)
        return energy(replace(scene, material=there, environment=EnvironmentMap(light)))

    assert scene.environment is not None
    leaves = [t.clone().requires_grad_() for t in (look.diffuse_albedo, look.roughness, scene.environment.radiance)]
    assert torch.autograd.gradcheck(value, leaves, eps=1e-7, rtol=1e-5)
