"""Gradients that are smoothed by a grid, in fits with fewer pixels than vertices."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from hir_core.errors import ConfigError
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Mesh, Scene, Topology
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.reflectance_renderers.transport_ggx.fit.gradient_grid import gradient_grid
from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import smooth_gradients
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface, refine
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.made_captures import (
    TEXELS,
    above,
    around,
    bowl,
    lamps,
    make_material,
    photographs,
    sky,
)
from tests.fixtures.scenes import icosphere, square


def plate(vertices: int) -> Surface:
    above, below = square(1.0, 1e-3), square(1.0, -1e-3)
    faces = torch.cat([above.faces, below.faces.flip(1) + len(above.positions)])
    mesh = Mesh(torch.cat([above.positions, below.positions]), Topology(faces))
    return refine(mesh, vertices)


@pytest.mark.parametrize("count", [100, 300, 2_000, 5_000])
def test_the_number_of_cells_is_near_the_one_asked_for(count: int) -> None:
    grid = gradient_grid(refine(icosphere(3), 10_000), count)
    assert grid is not None
    assert 0.7 * count < grid.cells < 1.4 * count
    assert grid.spacing == pytest.approx((grid.vertices / grid.cells) ** 0.5)


def test_no_grid_where_there_are_values_for_all_vertices() -> None:
    surface = refine(icosphere(2), 100)
    assert gradient_grid(surface, len(surface.positions)) is None


def test_a_surface_without_extent_has_a_grid_all_the_same() -> None:
    surface = refine(icosphere(1), 0)
    grid = gradient_grid(replace(surface, positions=torch.zeros_like(surface.positions)), 10)
    assert grid is not None and bool(torch.isfinite(grid.smoothed(torch.ones(grid.vertices, 3))).all())


def test_the_weights_of_a_vertex_add_up_to_one() -> None:
    """None is negative: a gradient that is the same everywhere keeps its sign."""
    grid = gradient_grid(refine(icosphere(3), 10_000), 500)
    assert grid is not None
    weights = grid.interpolation.matrix.to_dense()
    assert float(weights.min()) >= 0
    torch.testing.assert_close(weights.sum(dim=1), torch.ones(grid.vertices))


def test_a_gradient_reaches_its_neighbours_and_nobody_else() -> None:
    surface = refine(icosphere(3), 10_000)
    grid = gradient_grid(surface, 500)
    assert grid is not None
    one = torch.zeros(grid.vertices, 1)
    one[0] = 1
    found = grid.smoothed(one)[:, 0]
    distance = (surface.positions - surface.positions[0]).norm(dim=1)
    assert float(found[distance < 0.01].min()) > 0 and float(found.min()) >= 0
    assert float(found[distance > 0.5].abs().max()) == 0


def test_the_two_sides_of_a_thin_plate_share_nothing() -> None:
    surface = plate(4_000)
    grid = gradient_grid(surface, 200)
    assert grid is not None
    is_above = surface.positions[:, 1] > 0
    found = grid.smoothed(is_above[:, None].float())
    assert float(found[is_above].min()) > 0 and float(found[~is_above].abs().max()) == 0


def test_uniform_values_and_light_keep_their_gradients() -> None:
    surface = refine(icosphere(1), 0)
    grid, count = gradient_grid(surface, 10), len(surface.positions)
    assert grid is not None
    values = Parameters(
        torch.zeros(2, 4, 3),
        torch.zeros(count, 3),
        torch.zeros(1, 1),
        torch.zeros(count, 1),
        normal_offset=torch.zeros(count, 3),
    )
    assert values.width is not None and values.specular is not None and values.normal_offset is not None
    gradient = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    values.light.grad, values.specular.grad = torch.ones(2, 4, 3), torch.ones(1, 1)
    values.diffuse.grad, values.width.grad, values.normal_offset.grad = gradient, gradient[:, :1], gradient
    smooth_gradients(values, grid)
    torch.testing.assert_close(values.diffuse.grad, grid.smoothed(gradient))
    torch.testing.assert_close(values.width.grad, grid.smoothed(gradient[:, :1]))
    torch.testing.assert_close(values.normal_offset.grad, grid.smoothed(gradient))
    assert torch.equal(values.light.grad, torch.ones(2, 4, 3)) and torch.equal(values.specular.grad, torch.ones(1, 1))


@pytest.mark.slow
def test_with_few_pixels_views_left_out_gain() -> None:
    """A glossy ball of 10,000 vertices and 2,000 pixels: an albedo of each vertex shows the highlights of the
    photographs that it is fitted to, and hides them from the lobe.
    """
    mesh, _ = unwrap_mesh(icosphere(3), TEXELS)
    truth = Scene(mesh, make_material((0.4, 0.25, 0.15), 0.05, 0.2, "dielectric"), lamps())
    capture = photographs(truth, around(12))
    assert truth.environment is not None
    even = replace(truth.environment, radiance=torch.full_like(truth.environment.radiance, 0.5))
    grey = make_material(torch.full((TEXELS, TEXELS, 3), 0.3), 0.04, 0.4, "dielectric")
    error, alpha = {}, {}
    for per_value in (0.0, 2.5):
        options = TransportGGXOptions(
            vertices=12_000, cache_cells=300, steps=100, pixels=3_000, pixels_per_value=per_value
        )
        solver = TransportGGX(options).prepare(replace(truth, material=grey, environment=even), capture)
        fit = solver.fit(ModelSpec("dielectric", "uniform"), None, range(8), 1.0, lambda share: None)
        error[per_value] = float(solver.errors(fit, range(8, 12)).mean())
        alpha[per_value] = float(fit.parameters.alpha)
    assert error[2.5] < 0.8 * error[0.0], error
    assert abs(alpha[2.5] - 0.2) < 0.8 * abs(alpha[0.0] - 0.2), alpha


def test_under_a_known_light_few_pixels_start_near_the_albedo_between_walls() -> None:
    """A bowl of one colour: initial albedos leave out the light between its walls, and have no noise inside cells."""
    mesh, color = unwrap_mesh(bowl(), TEXELS)[0], torch.tensor([0.6, 0.4, 0.2])
    truth = Scene(mesh, make_material(color), sky())
    capture = photographs(truth, above(6, 0.9), depth=5)
    grey = make_material(torch.full((TEXELS, TEXELS, 3), 0.3), 0.0)
    deviation = {}
    for per_value in (0.0, 2.5):
        options = TransportGGXOptions(vertices=4_000, cache_cells=2_000, pixels_per_value=per_value)
        solver = TransportGGX(options).prepare(replace(truth, material=grey), capture)
        pixels = solver._pixels.subsampled(solver._pixels.of(range(6)), 0.2)
        seen = solver._transport.interpolation(pixels.points)[0].transposed @ torch.ones(len(pixels), 1) > 0.5
        spec = ModelSpec(bounces=3, light_is_known=True)
        start = solver._initial_parameters(spec, None, pixels).base_color[seen[:, 0]]
        torch.testing.assert_close(start.median(dim=0).values, color, rtol=0.05, atol=0)
        deviation[per_value] = float((start / color).log().std(dim=0).mean())
        direct = solver._initial_parameters(replace(spec, bounces=0), None, pixels).base_color[seen[:, 0]]
        assert float(direct[:, 0].median()) > 0.65, "with the light between the walls"
        metal = replace(spec, brdf="metallic", specular="uniform", metalness="metal")
        with_bounces, without = (
            solver._initial_parameters(replace(metal, bounces=bounces), None, pixels).base_color for bounces in (3, 0)
        )
        assert torch.equal(with_bounces, without), "irradiance says nothing about a metal's reflections"
    assert deviation[2.5] < 0.9 * deviation[0.0], deviation


@pytest.mark.parametrize("value", [-1, "many", float("nan")])
def test_a_number_of_pixels_that_is_none_is_refused(value: object) -> None:
    with pytest.raises(ConfigError, match="pixels_per_value"):
        PluginManager.discover().create("reflectance_renderer", "transport_ggx", {"pixels_per_value": value}, 0)
