"""The fit of the `metallic` BRDF at vertices: predictions, gradients, closed form, and recovery of known materials."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
import torch
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from torch import Tensor

from hir_core.capture import Capture
from hir_core.optimization.linear_maps import LinearMap
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Material, Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.reflectance_renderers.transport_ggx.fit.closed_form_albedo import (
    AlbedoEquations,
    MetalTerm,
    solve_albedo,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import solve_final_albedo
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.mini_batches import MiniBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.photograph_pixels import METAL_DIRECTIONS
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelBatch,
    predict,
    refresh_matrices,
    specular_matrices,
    srgb_residual,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.resident_batches import ResidentBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_metalness import metallic_of_albedos
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters, logit_of_alpha
from hir_plugins.reflectance_renderers.transport_ggx.fit.smoothness import SmoothnessWeights, smoothness_energy
from hir_plugins.reflectance_renderers.transport_ggx.operator.diffuse_transport import DiffuseTransport
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from tests.fixtures.made_captures import TEXELS, around, ball, bowl, lamps, painted, photographs

OPTIONS = TransportGGXOptions(vertices=0, cache_cells=300, samples=8, steps=120)
METAL = ModelSpec("metallic", "uniform", metalness="metal", light_is_known=True)
MIXED = replace(METAL, metalness="map")
GOLD = torch.tensor([0.9, 0.6, 0.25])
BLUE = torch.tensor([0.1, 0.2, 0.5])


def silent(share: float) -> None:
    """Ignores the progress."""


def double(value: object) -> object:
    """The value with float64 in place of float32, inside linear maps and data classes too."""
    if isinstance(value, Tensor):
        return value.double() if value.is_floating_point() else value
    if isinstance(value, LinearMap):
        return LinearMap(value.matrix.double(), value.transposed.double())
    if isinstance(value, PixelBatch | DiffuseTransport | Parameters):
        return replace(value, **{f.name: double(getattr(value, f.name)) for f in fields(value)})  # type: ignore[type-var]
    return value


@pytest.fixture(scope="module")
def half_gold() -> tuple[Scene, Capture]:
    """A ball, gold on the right and blue plastic on the left, under lamps, and its photographs."""
    mesh = ball()
    base, _ = painted(mesh, lambda p: torch.where(p[:, :1] > 0, GOLD, BLUE))
    metal, _ = painted(mesh, lambda p: (p[:, :1] > 0).float())
    truth = Scene(mesh, Material.metallic(base, metal, torch.tensor([0.25])), lamps())
    return truth, photographs(truth, around(10))


def solver_of(truth: Scene, capture: Capture) -> TransportSolver:
    grey = Material("dielectric", torch.full((TEXELS, TEXELS, 3), 0.5), torch.full((3,), 0.04), torch.tensor([0.1]))
    return TransportGGX(OPTIONS).prepare(replace(truth, material=grey), capture)


def batch_of(solver: TransportSolver, parameters: Parameters, bounces: int = 0) -> tuple[Transport, PixelBatch]:
    """The transport and one batch of a few pixels."""
    pixels = solver._pixels.of([0, 1]).take(torch.arange(0, 300, 6))
    return solver._transport, solver._pixels.batch(pixels, replace(MIXED, bounces=bounces), parameters, 0, 16, None)


def parameters_of(solver: TransportSolver, m: Tensor, f0: float = 0.04) -> Parameters:
    """A metallic surface of random base colours and that metalness, under lamps."""
    generator = torch.Generator().manual_seed(3)
    count = len(solver._transport.surface.positions)
    base = 0.1 + 0.8 * torch.rand(count, 3, generator=generator)
    width = logit_of_alpha(torch.tensor([[0.3]]))
    f0_logit = torch.logit(torch.tensor([[f0]]))
    return Parameters(lamps().radiance.log(), torch.logit(base), f0_logit, width, metalness=torch.logit(m))


def matrices_of(batch: PixelBatch, parameters: Parameters, model: str = "metallic") -> SpecularMatrices:
    (matrices,) = specular_matrices([batch], model)
    refresh_matrices([batch], [matrices], parameters)
    assert matrices is not None
    return matrices


def test_without_metal_the_prediction_is_that_of_dielectric(half_gold: tuple[Scene, Capture]) -> None:
    solver = solver_of(*half_gold)
    metallic = parameters_of(solver, torch.zeros(len(solver._transport.surface.positions), 1))
    dielectric = replace(metallic, metalness=None)
    transport, batch = batch_of(solver, metallic, 1)
    shown = predict(transport, batch, matrices_of(batch, metallic), metallic, 1)
    _, batch = batch_of(solver, dielectric, 1)
    same = predict(transport, batch, matrices_of(batch, dielectric, "dielectric"), dielectric, 1)
    torch.testing.assert_close(shown, same, rtol=2e-6, atol=1e-7)


def test_errors_do_not_contain_the_noise_of_directions() -> None:
    """Of the true metal, with few directions beside many. The next fit still has gradients."""
    truth = Scene(ball(), Material.metallic(GOLD, torch.ones(1), torch.tensor([0.25])), lamps())
    capture = photographs(truth, around(4))
    views, noisy, errors = list(range(4)), {}, {}
    for directions in (15, 1026):
        solver = TransportGGX(replace(OPTIONS, samples=directions // METAL_DIRECTIONS)).prepare(truth, capture)
        base = torch.logit(GOLD).expand(len(solver._transport.surface.positions), 3)
        fit = Fit(
            METAL,
            replace(
                parameters_of(solver, torch.ones(1, 1)), diffuse=base, width=logit_of_alpha(torch.tensor([[0.25]]))
            ),
        )
        pixels, renderings = solver._renderings(fit, views)
        residual = srgb_residual(pixels, renderings[0].clamp(0, 1))
        noisy[directions], errors[directions] = float(residual.square().mean()), float(solver.errors(fit, views).mean())
        assert torch.is_grad_enabled()
    assert noisy[1026] == pytest.approx(errors[1026], rel=0.02)
    excess = {"one draw": noisy[15] - errors[1026], "two draws": errors[15] - errors[1026]}
    assert excess["two draws"] < 0.5 * excess["one draw"], excess  # the rest is blur: 15 directions read coarser levels


def test_the_slope_in_a_map_of_widths_is_that_of_newly_drawn_lobes(half_gold: tuple[Scene, Capture]) -> None:
    """Against central differences of pictures with many directions at two narrow neighbours of each width."""
    solver = solver_of(*half_gold)
    count = len(solver._transport.surface.positions)
    widths = torch.linspace(0.15, 0.4, count)[:, None]
    parameters = replace(parameters_of(solver, torch.ones(count, 1)), width=logit_of_alpha(widths))
    pixels = solver._pixels.of([0, 1]).take(torch.arange(0, 300, 6))

    def picture(state: Parameters, directions: int) -> Tensor:
        batch = solver._pixels.batch(pixels, MIXED, state, 0, directions, None)
        return predict(solver._transport, batch, matrices_of(batch, state), state, 0)

    def make(state: Parameters, number: int) -> PixelBatch:
        return solver._pixels.batch(pixels, MIXED, state, number, 1024, None)

    source = MiniBatches(make, lambda state: make(state, 0), 1, 1)
    resident = ResidentBatches(
        source, parameters, parameters, "metallic", 5,
        lambda batch, matrices, state: predict(solver._transport, batch, matrices, state, 0),
    )  # fmt: skip
    batch, matrices = resident.at(0)
    assert matrices is not None and matrices.alpha_slope is not None
    step = 0.02
    below, above = (
        picture(replace(parameters, width=logit_of_alpha(widths * factor)), 8192) for factor in (1 - step, 1 + step)
    )
    expected = (above - below) / (2 * step * (batch.vertices @ widths))
    error = (matrices.alpha_slope - expected).norm() / expected.norm()
    assert float(expected.norm()) > 0.1
    assert float(error) < 0.03, float(error)


def test_a_metal_shows_its_lobe_alone(half_gold: tuple[Scene, Capture]) -> None:
    """With F0 in place of its base colour it is the lobe of `dielectric` with that coloured ρs and no diffuse part."""
    solver = solver_of(*half_gold)
    metal = parameters_of(solver, torch.ones(1, 1))
    assert metal.is_metal
    black = replace(metal, metalness=None, diffuse=torch.full_like(metal.diffuse, -30.0), specular=metal.diffuse)
    transport, batch = batch_of(solver, metal)
    shown = predict(transport, batch, matrices_of(batch, metal), metal, 0)
    same = predict(transport, batch, matrices_of(batch, black, "dielectric"), black, 0)
    torch.testing.assert_close(shown, same, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("bounces", [0, 1])
def test_gradients_are_finite_differences_in_float64(half_gold: tuple[Scene, Capture], bounces: int) -> None:
    """Of light, base colour, F0 and metalness, the smoothness included."""
    solver = solver_of(*half_gold)
    count = len(solver._transport.surface.positions)
    m = 0.1 + 0.8 * torch.rand(count, 1, generator=torch.Generator().manual_seed(1))
    transport, batch = batch_of(solver, parameters_of(solver, m), bounces)
    parameters = double(parameters_of(solver, m))
    assert isinstance(parameters, Parameters)
    assert batch.lobes is not None
    lobes = replace(batch.lobes, **{
        f.name: double(getattr(batch.lobes, f.name)) for f in fields(batch.lobes) if f.name != "sources"
    })  # fmt: skip
    batch = replace(double(batch), lobes=lobes)  # type: ignore[type-var]
    transport = replace(transport, diffuse=double(transport.diffuse), cell_average=double(transport.cell_average))  # type: ignore[arg-type]
    matrices = matrices_of(batch, parameters)
    weight = torch.rand(len(batch.view), 3, generator=torch.Generator().manual_seed(2)).double()
    names = ("light", "diffuse", "specular", "metalness")

    def energy(*values: Tensor) -> Tensor:
        changed = replace(parameters, **dict(zip(names, values, strict=True)))
        smooth = smoothness_energy(changed, SmoothnessWeights(), solver._edges)
        return (predict(transport, batch, matrices, changed, bounces) * weight).sum() + 100 * smooth

    start = [getattr(parameters, name) for name in names]
    leaves = [value.clone().requires_grad_() for value in start]
    gradients = torch.autograd.grad(energy(*leaves), leaves)
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for i, gradient in enumerate(gradients):
            direction = torch.randn(start[i].shape, generator=generator).double()
            up, down = (
                energy(*(v + s * 1e-5 * direction if j == i else v for j, v in enumerate(start))) for s in (1, -1)
            )
            difference = float((up - down) / 2e-5)
            assert float((gradient * direction).sum()) == pytest.approx(difference, rel=1e-6), names[i]


def test_closed_form_is_the_dense_least_squares_solution() -> None:
    """Random rows of a base colour that acts in both lobes; weights of the loss are 1, the prior is small."""
    generator = torch.Generator().manual_seed(0)
    rows, count, corners = 400, 20, 3
    columns = torch.stack([torch.randperm(count, generator=generator)[:corners] for _ in range(rows)])
    weights = torch.rand(rows, corners, generator=generator)
    weights = weights / weights.sum(1, keepdim=True)
    gain, metal_gain = (0.2 + torch.rand(rows, 3, generator=generator) for _ in range(2))
    m = torch.rand(count, 1, generator=generator)
    truth = 0.2 + 0.6 * torch.rand(count, 3, generator=generator)
    dense = torch.zeros(rows, count).scatter_(1, columns, weights)
    systems = [gain[:, c : c + 1] * dense * (1 - m.T) + metal_gain[:, c : c + 1] * dense * m.T for c in range(3)]
    target = torch.stack([system @ truth[:, c] for c, system in enumerate(systems)], dim=1)
    target = target + 0.02 * torch.randn(rows, 3, generator=generator)
    lookup = LinearMap.from_rows(columns, weights, count)
    equations = AlbedoEquations(
        lookup, gain, target, torch.ones_like(gain), torch.zeros_like(gain, dtype=torch.bool), MetalTerm(metal_gain, m)
    )
    found, _, _ = solve_albedo([equations], torch.full((count, 3), 0.5), huber_srgb=1e3, prior=1e-7)
    solutions = [torch.linalg.lstsq(a.double(), target[:, c : c + 1].double()).solution for c, a in enumerate(systems)]
    torch.testing.assert_close(found, torch.cat(solutions, dim=1).float(), rtol=0, atol=2e-4)


def test_closed_form_finds_the_base_colour_that_was_rendered(half_gold: tuple[Scene, Capture]) -> None:
    """From a base colour that is off by a quarter, for the prediction's own radiance; m between 0 and 1 included."""
    solver = solver_of(*half_gold)
    count = len(solver._transport.surface.positions)
    for m in (torch.zeros(count, 1), torch.ones(1, 1), torch.full((count, 1), 0.5)):
        truth = parameters_of(solver, m)
        pixels = solver._pixels.of(range(10))
        transport, batch = solver._transport, solver._pixels.batch(pixels, MIXED, truth, 0, 16, None)
        shown = predict(transport, batch, matrices_of(batch, truth), truth, 0)
        from hir_core.scene.srgb import linear_to_srgb

        batch = replace(batch, color_srgb=linear_to_srgb(shown), saturated=torch.zeros_like(batch.saturated))
        start = replace(truth, diffuse=torch.logit(0.75 * truth.base_color))
        seen = (batch.vertices.transposed @ torch.ones(len(pixels), 1))[:, 0] > 3
        refresh_matrices([batch], [matrices := matrices_of(batch, start)], start)
        solved = solve_final_albedo(transport, [(batch, matrices)], start, 0)
        found = solved.with_closed_form_albedo.base_color
        before = float((start.base_color - truth.base_color)[seen].abs().mean())
        assert float((found - truth.base_color)[seen].abs().mean()) < 0.2 * before


def test_metallic_parameters_of_albedos_are_exact() -> None:
    generator = torch.Generator().manual_seed(0)
    base, m = torch.rand(500, 3, generator=generator), torch.rand(500, 1, generator=generator)
    m[:100], m[100:200] = 0.0, 1.0
    made = Material.metallic(base[None], m[None], torch.ones(1))
    f0 = torch.tensor([[DEFAULT_DIELECTRIC_F0]])
    color, metalness = metallic_of_albedos(made.diffuse_albedo[0], made.specular_albedo[0], f0)
    bright = base.mean(dim=1) > 0.1  # as dark as F0, a metal and a dielectric are nearly the same
    torch.testing.assert_close(color[bright], base[bright], rtol=0, atol=2e-4)
    torch.testing.assert_close(metalness[bright], m[bright], rtol=0, atol=2e-3)


def fitted_maps(solver: TransportSolver, spec: ModelSpec, effort: float = 1.0) -> tuple[Fit, Material]:
    fit = solver.fit(spec, None, range(10), effort, silent)
    material = solver.scene(fit, range(10), silent).scene.material
    assert material is not None and material.model == "metallic"
    return fit, material


def test_a_ball_that_is_half_gold_is_recovered(half_gold: tuple[Scene, Capture]) -> None:
    """Under the known light: metalness of each half, base colours, and α."""
    truth, capture = half_gold
    _, material = fitted_maps(solver_of(truth, capture), MIXED)
    assert truth.material is not None and truth.material.metalness is not None and material.metalness is not None
    seen = material.observed
    assert seen is not None
    gold = seen & (truth.material.metalness[..., 0] > 0.5)
    blue = seen & (truth.material.metalness[..., 0] < 0.5)
    assert float(material.metalness[gold].mean()) > 0.85 and float(material.metalness[blue].mean()) < 0.15
    assert float((material.base_color - truth.material.base_color)[gold].abs().mean()) < 0.06
    assert float((material.base_color - truth.material.base_color)[blue].abs().mean()) < 0.06
    assert float(material.roughness.mean()) == pytest.approx(0.25, abs=0.06)


@pytest.mark.slow
def test_a_metal_bowl_is_recovered() -> None:
    """All metal: no diffuse lobe, metalness one number, the colour in a texture."""
    mesh = unwrap_mesh(bowl(), TEXELS)[0]
    base, _ = painted(mesh, lambda p: GOLD * (0.75 + 0.25 * torch.sin(3 * p[:, :1])))
    truth = Scene(mesh, Material.metallic(base, torch.ones(1), torch.tensor([0.3])), lamps())
    solver = solver_of(truth, photographs(truth, around(10)))
    _, material = fitted_maps(solver, METAL)
    assert material.metalness is not None and material.metalness.tolist() == [1.0]
    assert float(material.diffuse_albedo.abs().max()) == 0
    assert material.observed is not None
    error = (material.base_color - base)[material.observed].abs()
    assert float(error.mean()) < 0.05
    assert float(material.roughness.mean()) == pytest.approx(0.3, abs=0.05)
