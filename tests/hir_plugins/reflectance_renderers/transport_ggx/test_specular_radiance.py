"""One matrix for each lobe, against the sum over its directions with Fresnel's term of each."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_core.scene import Scene
from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.brdf_torch import schlick_weight
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import visible_points
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.made_captures import around, ball, lamps, make_material, photographs

COPPER = torch.tensor([[0.95, 0.64, 0.54]])
MakeLobes = Callable[[float], Lobes]


@pytest.fixture(scope="module")
def scene() -> tuple[Transport, MakeLobes]:
    """The transport of a ball that one camera sees, and its lobes with 64 directions at a width."""
    truth = Scene(ball(), make_material((0.3, 0.2, 0.1)), lamps())
    capture = photographs(truth, around(1))
    transport = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=200)).prepare(truth, capture)._transport  # type: ignore[attr-defined]
    grid = torch.tensor([(0, x, y) for y in range(32) for x in range(32)])
    points, found = visible_points(transport.tracer, transport.surface, {0: capture.cameras[0]}, grid)
    seen = points.take(found.nonzero()[:, 0])
    return transport, lambda alpha: transport.lobes(seen, torch.tensor([[alpha]]), 64)


def summed(lobes: Lobes, sources: Tensor, rho_s: Tensor, alpha: Tensor) -> Tensor:
    """The radiance of each direction, with Fresnel's term of its own, added up."""
    weight, _ = lobes.weights(alpha)
    fresnel = rho_s[:, None, :] + (1 - rho_s[:, None, :]) * schlick_weight(lobes.h_wo)[..., None]
    taps = sources[lobes.columns.long()].reshape(*weight.shape, 4, 3)
    arriving = (taps * lobes.bilinear.reshape(*weight.shape, 4, 1)).sum(dim=2)
    return (weight[..., None] * fresnel * arriving).sum(dim=1)


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.9])
def test_for_the_albedo_of_the_refresh_it_is_the_sum(scene: tuple[Transport, MakeLobes], alpha: float) -> None:
    transport, lobes_of = scene
    lobes, width, rho_s = lobes_of(alpha), torch.tensor([[alpha]]), torch.tensor([[0.04]])
    sources = transport.sky_only(lamps().radiance)
    matrices = SpecularMatrices(lobes, "dielectric")
    matrices.refresh(width, rho_s)
    found, expected = matrices.radiance(sources, rho_s, width), summed(lobes, sources, rho_s, width)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("model", ["dielectric", "metallic"])
def test_under_a_white_light_it_is_the_sum_for_every_albedo(scene: tuple[Transport, MakeLobes], model: str) -> None:
    _, lobes_of = scene
    lobes, width = lobes_of(0.3), torch.tensor([[0.3]])
    sources = torch.ones(lobes.sources, 3)
    matrices = SpecularMatrices(lobes, model)  # type: ignore[arg-type]
    matrices.refresh(width, torch.tensor([[0.5]]))
    for rho_s in (COPPER, torch.zeros(1, 3), torch.ones(1, 3)):
        found, expected = matrices.radiance(sources, rho_s, width), summed(lobes, sources, rho_s, width)
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.9])
def test_a_coloured_metal_differs_by_less_than_its_directions_do(
    scene: tuple[Transport, MakeLobes], alpha: float
) -> None:
    """Channels share one matrix, whose Fresnel term is that of their mean: below the noise of 64 directions."""
    transport, lobes_of = scene
    lobes, width = lobes_of(alpha), torch.tensor([[alpha]])
    sources = transport.sky_only(lamps().radiance)
    matrices = SpecularMatrices(lobes, "metallic")
    matrices.refresh(width, COPPER)
    found, expected = matrices.radiance(sources, COPPER, width), summed(lobes, sources, COPPER, width)
    error = linear_to_srgb(found.clamp(0, 1)) - linear_to_srgb(expected.clamp(0, 1))
    assert -10 * np.log10(float(error.square().mean())) > 55
