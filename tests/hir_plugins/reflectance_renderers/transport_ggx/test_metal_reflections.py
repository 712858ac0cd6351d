"""Metal that reflects metal, against the path tracer and against lobes without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_core.capture import Capture, Pixels, View
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.metal_reflections import (
    METAL_FROM,
    MetalSurface,
    metal_color,
    sources_by_reflections,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints, visible_points
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.scenes import icosphere, looking_at
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import solver_of

GOLD = torch.tensor([0.9, 0.6, 0.2])
SIZE = 96
DIRECTIONS = 128
BOUNCES = 3


def capture() -> Capture:
    blank = Pixels(
        np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE), bool)
    )
    return Capture(Path("made"), (View("000", looking_at((0, 1, 4), SIZE, SIZE), lambda: blank),))


def pixels() -> Tensor:
    return torch.tensor([(0, x, y) for y in range(SIZE) for x in range(SIZE)])


def two_balls() -> Mesh:
    large, small = icosphere(4), icosphere(3, 0.45)
    positions = torch.cat([large.positions, small.positions + torch.tensor([0.3, 1.2, 0.9])])
    return Mesh(positions, Topology(torch.cat([large.faces, small.faces + len(large.positions)])))


def light() -> Tensor:
    """Bright above on one side, dark below: the direction in which a reflection goes on matters."""
    rows = torch.linspace(1.5, 0.1, 32)[:, None, None]
    columns = 1 + 0.8 * torch.linspace(0, 2 * torch.pi, 64).cos()[None, :, None]
    return rows * columns * torch.tensor([1.0, 0.8, 0.6])


@pytest.fixture(scope="module")
def seen() -> tuple[Transport, SurfacePoints, Tensor]:
    """The transport of two balls, the points behind the pixels of a camera, and the numbers of these pixels."""
    scene = Scene(two_balls(), Material.metallic(GOLD, torch.ones(1), torch.full((1,), 0.3)), EnvironmentMap(light()))
    options = TransportGGXOptions(vertices=0, cache_cells=3000)
    transport = TransportGGX(options).prepare(scene, capture())._transport  # type: ignore[attr-defined]
    points, found = visible_points(transport.tracer, transport.surface, {0: capture().cameras[0]}, pixels())
    rows = found.nonzero()[:, 0]
    return transport, points.take(rows), rows


def metal_of(transport: Transport, color: Tensor, alpha: float, metalness: float | Tensor = 1.0) -> MetalSurface:
    base = color.expand(len(transport.surface.positions), 3)
    metal = transport.metal_surface(base, torch.full((1, 1), alpha), torch.as_tensor(metalness).reshape(-1, 1), BOUNCES)
    assert metal is not None
    return metal


def shown(
    transport: Transport, points: SurfacePoints, color: Tensor, alpha: float, metal: MetalSurface | None, seed: int = 0
) -> Tensor:
    """Radiance of an all-metal surface."""
    width = torch.full((1, 1), alpha)
    lobes = transport.lobes(points, width, DIRECTIONS, None, seed, metal)
    base = color.expand(len(transport.surface.positions), 3)
    sources, _ = transport.sources(light(), base, BOUNCES, None if metal is None else torch.ones(1, 1))
    assert lobes.sources == len(sources)
    matrices = SpecularMatrices(lobes, "metallic")
    matrices.refresh(width, color[None])
    return matrices.radiance(sources, color[None], width)


@pytest.mark.parametrize(
    ("alpha", "color", "gain"),
    [
        (0.1, GOLD, 2.5),
        pytest.param(0.3, GOLD, 1.2, marks=pytest.mark.slow),
        pytest.param(0.1, torch.full((3,), 0.9), 2.5, marks=pytest.mark.slow),
    ],
)
def test_agrees_with_the_path_tracer(
    seen: tuple[Transport, SurfacePoints, Tensor], alpha: float, color: Tensor, gain: float
) -> None:
    """Where reflections bring more than 15 %, against paths of at most five surfaces; cells alone have `gain` times
    the error."""
    transport, points, rows = seen
    material, environment = Material.metallic(color, torch.ones(1), torch.full((1,), alpha)), EnvironmentMap(light())
    scene = Scene(two_balls(), material, environment)
    traced = []
    for depth in (2, 6):
        torch.manual_seed(0)
        tracer = MitsubaGGX(MitsubaGGXOptions(samples=256, max_depth=depth)).prepare(scene, capture())
        traced.append(tracer.radiance(material, environment, pixels())[rows])
    direct, reference = traced
    compared = (reference - direct).sum(1) > 0.15 * reference.sum(1)
    assert int(compared.sum()) > 300

    def error(metal: MetalSurface | None) -> tuple[float, float]:
        difference, mean = (shown(transport, points, color, alpha, metal) - reference)[compared], reference[compared]
        return abs(float(difference.mean() / mean.mean())), float(difference.abs().mean() / mean.mean())

    bias, deviation = error(metal_of(transport, color, alpha))
    assert bias < 0.025 and deviation < 0.11
    assert error(None)[1] > gain * deviation


def test_without_metal_where_a_direction_ends_it_reads_what_it_read_before(
    seen: tuple[Transport, SurfacePoints, Tensor],
) -> None:
    transport, points, _ = seen
    plain = transport.lobes(points, torch.full((1, 1), 0.3), 16)
    none = transport.lobes(
        points, torch.full((1, 1), 0.3), 16, None, 0, metal_of(transport, GOLD, 0.3, 0.9 * METAL_FROM)
    )
    assert torch.equal(plain.columns, none.columns) and torch.equal(plain.bilinear, none.bilinear)


def test_directions_that_leave_the_surface_are_those_without_metal(
    seen: tuple[Transport, SurfacePoints, Tensor],
) -> None:
    transport, points, _ = seen
    plain = transport.lobes(points, torch.full((1, 1), 0.3), 16)
    metal = transport.lobes(points, torch.full((1, 1), 0.3), 16, None, 0, metal_of(transport, GOLD, 0.3))
    leaves = plain.columns < transport.pyramid.texels
    assert 0.02 < float((~leaves).float().mean()) < 0.5
    assert torch.equal(plain.columns[leaves], metal.columns[leaves])
    assert bool((metal.columns[~leaves] >= transport.source_count).all()), "each has been reflected at least once"
    assert torch.equal(plain.toward_light, metal.toward_light)


def test_the_seed_decides_where_reflections_go(seen: tuple[Transport, SurfacePoints, Tensor]) -> None:
    transport, points, _ = seen
    metal, width = metal_of(transport, GOLD, 0.3), torch.full((1, 1), 0.3)
    first, again, other = (transport.lobes(points, width, 8, None, seed, metal) for seed in (1, 1, 1 << 33))
    assert torch.equal(first.columns, again.columns) and torch.equal(first.bilinear, again.bilinear)
    assert not torch.equal(first.columns, other.columns)


@pytest.mark.parametrize("alpha", [0.0, 1e-4, 1.0])
@pytest.mark.parametrize("color", [0.0, 1.0])
def test_hard_cases_are_finite(seen: tuple[Transport, SurfacePoints, Tensor], alpha: float, color: float) -> None:
    """A black metal, a white one, the narrowest and the widest lobe."""
    transport, points, _ = seen
    value = torch.full((3,), color)
    metal = metal_of(transport, value, alpha)
    lobes = transport.lobes(points, torch.full((1, 1), max(alpha, 1e-3)), 8, None, 0, metal)
    assert bool(torch.isfinite(lobes.bilinear).all()) and float(lobes.bilinear.min()) >= 0
    assert 0 <= int(lobes.columns.min()) <= int(lobes.columns.max()) < lobes.sources
    assert bool(torch.isfinite(shown(transport, points, value, max(alpha, 1e-3), metal)).all())


def test_each_block_is_tinted_once_more() -> None:
    sources = torch.rand(5, 3, dtype=torch.float64)
    color = torch.tensor([0.9, 0.5, 0.1], dtype=torch.float64)
    blocks = sources_by_reflections(sources, color, 2).reshape(3, 5, 3)
    for number in range(3):
        torch.testing.assert_close(blocks[number], sources * color**number)


def test_the_mean_colour_is_that_of_the_metal() -> None:
    base = torch.tensor([[0.9, 0.6, 0.2], [0.1, 0.1, 0.1]])
    torch.testing.assert_close(metal_color(base, torch.tensor([[1.0], [0.0]])), base[0])
    torch.testing.assert_close(metal_color(base, torch.ones(1, 1)), base.mean(dim=0))
    assert bool(torch.isfinite(metal_color(base, torch.zeros(1, 1))).all())


def test_gradients_of_the_blocks_are_finite_differences() -> None:
    """In the light, in the base colour and in the metalness."""
    generator = torch.Generator().manual_seed(0)
    sources, base, metalness = (
        torch.rand(*shape, dtype=torch.float64, generator=generator).requires_grad_()
        for shape in ((4, 3), (6, 3), (6, 1))
    )
    assert torch.autograd.gradcheck(
        lambda s, b, m: sources_by_reflections(s, metal_color(b, m), 3), (sources, base, metalness)
    )


def test_a_fit_of_metal_has_more_directions_of_fewer_pixels() -> None:
    fit, _ = solver_of(pixels=900)
    metal, plastic = ModelSpec("metallic", "uniform", metalness="metal"), ModelSpec("dielectric", "uniform")
    views = range(6)
    of_metal, of_plastic = (fit._pixels.recent(views, 1.0, spec) for spec in (metal, plastic))
    assert len(of_plastic) > 600
    assert 0.25 < len(of_metal) / (900 * 6 / len(fit._capture.views)) < 0.42
    directions = []
    for spec, photographs in ((metal, of_metal), (plastic, of_plastic)):
        parameters = fit._initial_parameters(spec, None, photographs)
        lobes = fit._pixels.batches(photographs, spec).make(parameters, 0).lobes
        assert lobes is not None
        directions.append(lobes.n_wi.shape[1])
    assert directions == [3 * fit._options.samples, fit._options.samples]


def test_a_light_on_the_camera_has_no_reflections_of_metal() -> None:
    """Its direction in the world differs from view to view, and that of a reflection would have to follow."""
    fit, _ = solver_of()
    spec = ModelSpec("metallic", "uniform", metalness="metal", bounces=1)
    photographs = fit._pixels.recent(range(6), 1.0, spec)
    parameters = fit._initial_parameters(spec, None, photographs)
    for moving in (False, True):
        own = replace(spec, light_frame="camera" if moving else "world")
        lobes = fit._pixels.batches(photographs, own).make(parameters, 0).lobes
        assert lobes is not None
        assert lobes.sources == fit._transport.source_count * (1 if moving else 2)
