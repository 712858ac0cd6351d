"""Shading normals: against formulas, the path tracer, and a scene with a normal map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.capture import Capture
from hir_core.errors import ConfigError
from hir_core.mesh.texel_rasterization import dilate, texel_surface
from hir_core.scene import EnvironmentMap, Mesh, Scene
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import (
    MAX_NORMAL_OFFSET,
    offset_normals,
    shading_normal_irradiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import visible_points
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import mapped_normals, normal_map
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import sample
from tests.fixtures.made_captures import (
    BROWN,
    TEXELS,
    around,
    ball,
    fitted,
    lamps,
    make_material,
    photographs,
    sky,
    unseen_db,
)


def waves(place: Tensor) -> Tensor:
    """Normal offsets, in the world, of dents that an icosphere of 642 vertices just resolves."""
    return 0.35 * torch.stack([torch.sin(7 * place[:, 1]), torch.sin(6 * place[:, 2]), torch.cos(7 * place[:, 0])], 1)


def dented(mesh: Mesh, texels: int = TEXELS) -> Tensor:
    """The normal map of `waves`."""
    surface = texel_surface(mesh, texels)
    normal_offset = torch.zeros(texels, texels, 3)
    normal_offset[surface.covered] = waves(surface.position)
    return normal_map(mesh, dilate(normal_offset, surface.covered, 8), 8)


def prepared(scene: Scene, capture: Capture, **options: int) -> TransportSolver:
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=3000, **options)).prepare(scene, capture)  # type: ignore[arg-type]
    assert isinstance(solver, TransportSolver)
    return solver


def test_a_zero_offset_keeps_the_normal_and_a_huge_one_stays_above_the_horizon() -> None:
    torch.manual_seed(0)
    normal = normalize(torch.randn(50, 3), dim=1)
    torch.testing.assert_close(offset_normals(normal, torch.zeros(50, 3)), normal)
    torch.testing.assert_close(offset_normals(normal, 3 * normal), normal, atol=1e-6, rtol=0)
    for size in (1e-20, 1.0, 1e15):
        normal_offset = (size * torch.randn(50, 3)).requires_grad_()
        turned = offset_normals(normal, normal_offset)
        turned.sum().backward()
        assert normal_offset.grad is not None and bool(torch.isfinite(normal_offset.grad).all())
        cosine = (turned * normal).sum(dim=1)
        assert float(cosine.detach().min()) > 1 / (1 + MAX_NORMAL_OFFSET**2) ** 0.5 - 1e-5
        torch.testing.assert_close(turned.detach().norm(dim=1), torch.ones(50))


def test_offset_normals_have_the_gradient_of_their_formula() -> None:
    torch.manual_seed(1)
    normal = normalize(torch.randn(6, 3, dtype=torch.float64), dim=1)
    normal_offset = torch.randn(6, 3, dtype=torch.float64, requires_grad=True)
    light = torch.rand(6, 3, dtype=torch.float64, requires_grad=True)
    vectors = torch.rand(6, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: offset_normals(normal, t), (normal_offset,))
    assert torch.autograd.gradcheck(
        lambda t, e, f: shading_normal_irradiance(normal, offset_normals(normal, t), e, f),
        (normal_offset, light, vectors),
    )


def test_vector_irradiance_is_the_irradiance_of_other_normals() -> None:
    """On a ball under soft light from one side: that of the next cell's normal, except light below the horizon."""
    d = texel_directions(32, 64)
    light = (0.05 + (4 * (d @ normalize(torch.tensor([0.3, 1.0, 0.2]), dim=0) - 1)).exp())[:, None].expand(-1, 3)
    radiance = light.reshape(32, 64, 3).contiguous()
    truth = Scene(ball(), make_material(BROWN), EnvironmentMap(radiance))
    transport = prepared(truth, photographs(truth, around(1)))._transport
    normal = transport.irradiance_cache.normals
    _, irradiance = transport.sources(radiance, torch.zeros(len(transport.surface.positions), 3), 0)
    # the next cell's normal, some 7° away
    other = (normal @ normal.T - torch.eye(len(normal)) * 2).argmax(dim=1)
    found = shading_normal_irradiance(normal, normal[other], irradiance, transport.vector_irradiance(radiance))
    error, moved = ((value - irradiance[other]).abs().mean() for value in (found, irradiance))
    assert float(moved) > 0.02 * float(irradiance.mean()) and float(error) < 0.15 * float(moved)


def test_a_normal_map_contains_the_normals_it_was_made_of() -> None:
    mesh = ball()
    truth = Scene(mesh, make_material(BROWN), sky())
    capture = photographs(truth, around(1))
    transport = prepared(truth, capture)._transport
    grid = torch.tensor([(0, x, y) for y in range(32) for x in range(32)])
    points, found = visible_points(transport.tracer, transport.surface, {0: capture.cameras[0]}, grid)
    points = points.take(found.nonzero()[:, 0])
    values = sample(dented(mesh, 256), points.uvs(transport.surface))
    assert float((dented(mesh, 256).norm(dim=2) - 1).abs().max()) < 1e-5
    turned = mapped_normals(transport.surface, points, values)
    expected = offset_normals(points.normal, waves(points.position))
    angle = torch.rad2deg(torch.acos((turned * expected).sum(dim=1).clamp(-1, 1)))
    assert float(angle.mean()) < 0.5 and float(angle.quantile(0.99)) < 3
    assert float(torch.rad2deg(torch.acos((turned * points.normal).sum(dim=1))).mean()) > 10


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_shading_of_a_normal_map_is_the_path_tracers(model: str) -> None:
    mesh = ball()
    material = replace(make_material((0.5, 0.3, 0.2), 0.2, 0.3, model), normal=dented(mesh, 256))
    truth = Scene(mesh, material, lamps())
    capture = photographs(truth, around(2), depth=2)
    grid = torch.tensor([(v, x, y) for v in range(2) for y in range(32) for x in range(32)])
    tracer = MitsubaGGX(MitsubaGGXOptions(samples=1024, max_depth=2)).prepare(truth, capture)
    assert truth.environment is not None
    with torch.no_grad():
        expected = tracer.radiance(material, truth.environment, grid)
        found = prepared(truth, capture, samples=64).radiance(material, truth.environment, grid)
        flat = prepared(truth, capture, samples=64).radiance(replace(material, normal=None), truth.environment, grid)
    inside = _inner(capture)
    scale = expected[inside].mean()
    error = (found - expected)[inside].abs().mean() / scale
    assert float((flat - expected)[inside].abs().mean() / scale) > 0.08
    assert float(error) < 0.03
    assert abs(float((found - expected)[inside].mean() / scale)) < 0.01


def _inner(capture: Capture) -> Tensor:
    """Pixels (N,) away from the silhouette."""
    masks = [view.read().mask for view in capture.views]
    inner = [binary_erosion(mask > 0, iterations=3) for mask in masks if mask is not None]
    return torch.from_numpy(np.stack(inner)).reshape(-1)


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_a_lobes_derivative_in_the_normal(model: str) -> None:
    """To first order that of matrices that are rebuilt for the moved normals."""
    mesh = ball()
    truth = Scene(mesh, make_material(BROWN), lamps())
    capture = photographs(truth, around(1))
    transport = prepared(truth, capture)._transport
    grid = torch.tensor([(0, x, y) for y in range(8, 24) for x in range(8, 24)])
    points, found = visible_points(transport.tracer, transport.surface, {0: capture.cameras[0]}, grid)
    lobes = transport.lobes(points.take(found.nonzero()[:, 0]), torch.tensor([[0.3]]), 64)
    sources = transport.sky_only(lamps().radiance)
    alpha, rho_s = torch.tensor([[0.3]]), torch.tensor([[0.2]])
    up = torch.tensor([0.0, 0.0, 1.0]).expand(len(lobes), 3)
    step = 0.02 * torch.tensor([0.6, -0.8, 0.0])
    moved = normalize(up + step, dim=1)
    block = SpecularMatrices(lobes, model)  # type: ignore[arg-type]
    block.refresh(alpha, rho_s, up)
    normal = up.clone().requires_grad_()
    straight = block.radiance(sources, rho_s, alpha, normal)
    predicted = block.radiance(sources, rho_s, alpha, moved)
    straight.sum().backward()
    assert normal.grad is not None
    block.refresh(alpha, rho_s, moved)
    exact = block.radiance(sources, rho_s, alpha, moved)
    change = (exact - straight).detach()
    assert float((predicted - exact).detach().abs().mean()) < 0.12 * float(change.abs().mean())
    assert float((normal.grad * step).sum()) == pytest.approx(float(change.sum()), rel=0.15)


def bumpy(mesh: Mesh) -> Scene:
    """Dark and glossy: dents are visible only through the highlights that they move."""
    return Scene(mesh, replace(make_material((0.1, 0.08, 0.05), 0.3, 0.3), normal=dented(mesh, 256)), lamps())


@pytest.mark.slow
def test_dents_are_found_in_photographs(tmp_path: Path) -> None:
    """Under a known light; without a normal map unseen views are 6 dB worse."""
    mesh = ball()
    truth = bumpy(mesh)
    capture = photographs(truth, around(14), size=64)
    plain, dents = (
        fitted(mesh, capture, tmp_path / model, light=lamps(), brdf="paper", model=model, options={"vertices": 2000})[0]
        for model in ("specular", "normal_map")
    )
    assert plain.material is not None and plain.material.normal is None
    material, true = dents.material, dented(mesh)
    assert material is not None and material.normal is not None and material.observed is not None
    known = material.observed & texel_surface(mesh, TEXELS).covered
    turned, left = (
        torch.rad2deg(torch.acos(cosine.clamp(-1, 1))).mean()
        for cosine in (true[known][:, 2], (material.normal[known] * true[known]).sum(dim=1))
    )
    assert float(turned) > 15 and float(left) < 0.6 * float(turned)
    assert unseen_db(dents, truth) > unseen_db(plain, truth) + 4


@pytest.mark.slow
def test_model_selection_finds_dents(tmp_path: Path) -> None:
    """Under an unknown light. A roughness map, which gains .07 ± .07 dB on held-out views, imitates them."""
    mesh = ball()
    truth = bumpy(mesh)
    scene, report = fitted(
        mesh, photographs(truth, around(16), size=64), tmp_path, brdf="paper", options={"vertices": 2000}
    )
    assert "normal map" in report.model
    assert scene.material is not None and scene.material.normal is not None
    assert unseen_db(scene, truth) > 36, "34.6 dB with the roughness map"


def test_a_light_on_the_camera_excludes_normal_maps(tmp_path: Path) -> None:
    """A setting that requests them is an error: the light at a point differs between photographs."""
    truth = bumpy(ball())
    with pytest.raises(ConfigError, match="normal_map"):
        fitted(truth.mesh, photographs(truth, around(6)), tmp_path, model="normal_map", light_frame="camera")
