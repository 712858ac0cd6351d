"""Regularizers inside the solver: exact gradients, what they drive, third-party terms, weight 0, interrupted fits."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_core.capture import Capture, Pixels, View
from hir_core.optimization.linear_maps import LinearMap
from hir_core.optimization.weighted_energies import solver_terms
from hir_core.plugins.interfaces import CheckpointLocation, WeightedTerm
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import FitCheckpoint
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_terms import FitTerms, material_at_vertices
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import (
    PIXEL_TERM,
    fit,
    objective,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.proximal_step import proximal_step
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from tests.fixtures.made_captures import around, lamps, make_material
from tests.fixtures.scenes import icosphere, looking_at

PLUGIN = '''
"""A third party's terms of light, roughness and albedo, through the interface alone."""

from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import Regularizer

class Brightness(Regularizer):
    """(mean radiance - 2)^2, and that of roughness to 0.7."""

    def __init__(self, config):
        pass

    def prepare(self, scene):
        def energy(scene):
            light = (scene.environment.radiance.mean() - 2).square()
            return light + (scene.material.roughness - 0.7).square().mean()

        return energy


@hookimpl
def hir_register_regularizers():
    traits = {"differentiable", "material", "environment"}
    plain = Component("brightness", "hir_plugin_brightness:Brightness", traits=frozenset(traits))
    return [plain] + [
        Component(f"brightness_{trait}", "hir_plugin_brightness:Brightness", traits=frozenset(traits | {trait}))
        for trait in ("vertex_maps", "lagged")
    ]
'''
SIZE = 20
VIEWS = range(6)
GLOSSY = ModelSpec("dielectric", "map", "map")
OPTIONS = TransportGGXOptions(vertices=0, cache_cells=100, steps=60, texture_pixels=3000, block_pixels=400, samples=8)
HUGE = 1e7
NAMES = ("brightness", "brightness_vertex_maps", "brightness_lagged")


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> PluginManager:
    path = tmp_path_factory.mktemp("plugin") / "brightness.py"
    path.write_text(PLUGIN)
    return PluginManager.discover((str(path),))


@pytest.fixture(scope="module")
def solver() -> TransportSolver:
    """Of six photographs of a striped ball under lamps, made by the renderer itself."""
    mesh, _ = unwrap_mesh(icosphere(2), 32)
    stripes = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(0)) * 0.4 + 0.2
    truth = Scene(mesh, make_material(stripes, 0.04, 0.3, "dielectric"), lamps(8))
    assert truth.material is not None and truth.environment is not None
    cameras = [looking_at(eye, SIZE, SIZE) for eye in around(len(VIEWS))]
    nothing = np.zeros((SIZE, SIZE), bool)

    def capture(colors: np.ndarray) -> Capture:
        covered = (colors.sum(axis=3) > 0).astype(np.float32)
        pixels = [Pixels(color, mask, nothing) for color, mask in zip(colors, covered, strict=True)]
        views = [View(str(i), c, lambda p=p: p) for i, (c, p) in enumerate(zip(cameras, pixels, strict=True))]  # type: ignore[misc]
        return Capture(Path("made"), tuple(views))

    blank = TransportGGX(OPTIONS).prepare(truth, capture(np.zeros((len(VIEWS), SIZE, SIZE, 3), np.float32)))
    grid = torch.tensor([(v, x, y) for v in VIEWS for y in range(SIZE) for x in range(SIZE)])
    colors = blank.radiance(truth.material, truth.environment, grid).reshape(len(VIEWS), SIZE, SIZE, 3).numpy()
    start = replace(truth, material=make_material(torch.full((32, 32, 3), 0.5), 0.04, 0.3))
    light = EnvironmentMap(torch.full((8, 16, 3), 0.5))
    return TransportGGX(OPTIONS).prepare(replace(start, environment=light), capture(colors))


def silent(share: float) -> None:
    """Ignores the progress."""


def terms_of(plugins: PluginManager, tables: Mapping[str, Mapping[str, Any]]) -> tuple[WeightedTerm, ...]:
    return solver_terms(tables, plugins, 0, {})


def fitted(solver: TransportSolver, spec: ModelSpec, terms: tuple[WeightedTerm, ...]) -> Fit:
    return (solver.with_terms(terms) if terms else solver).fit(spec, None, VIEWS, 1.0, silent)


@pytest.fixture(scope="module")
def plain(solver: TransportSolver) -> Fit:
    return fitted(solver, GLOSSY, ())


@pytest.mark.parametrize("name", [NAMES[1], *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[::2])])
def test_a_third_partys_term_shapes_light_and_roughness_inside_the_fit(
    solver: TransportSolver, plugins: PluginManager, plain: Fit, name: str
) -> None:
    """The light becomes as bright as the term wants, the lobe wider, and the albedo darker, which explains the
    photographs. A term that acts after the fit leaves the parameters at vertices as they were."""
    driven = fitted(solver, GLOSSY, terms_of(plugins, {name: {"weight": HUGE}}))
    assert float(plain.parameters.radiance.mean()) < 1.5
    assert float(driven.parameters.radiance.mean()) == pytest.approx(2, abs=0.1)
    far = [float((each.parameters.alpha - 0.7).abs().mean()) for each in (plain, driven)]
    assert far[1] < far[0] - 0.015, "the width is frozen for the first 70 % of 60 steps"
    albedo = [float(each.scene_parameters.diffuse_albedo.mean()) for each in (plain, driven)]
    assert albedo[1] < 0.8 * albedo[0]


def test_weight_0_gives_the_bits_of_no_term(solver: TransportSolver, plugins: PluginManager, plain: Fit) -> None:
    terms = terms_of(plugins, {"brightness": {"weight": 0.0}, "total_variation": False})
    assert terms == ()
    again = fitted(solver.with_terms(terms), GLOSSY, ())  # type: ignore[arg-type]
    assert_same(again.parameters, plain.parameters)


def assert_same(one: Parameters, other: Parameters) -> None:
    for field in fields(Parameters):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert (a is None and b is None) or torch.equal(a, b), field.name


def doubled(part: Any) -> Any:
    """The same with all tensors and linear maps of a dataclass tree in float64."""
    if isinstance(part, Tensor):
        return part.double() if part.is_floating_point() else part
    if isinstance(part, LinearMap):
        return LinearMap(part.matrix.double())
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        values = {f.name: doubled(getattr(part, f.name)) for f in fields(part)}
        return replace(part, **values)
    return part


@pytest.mark.parametrize("brdf", ["diffuse", "dielectric"])
def test_the_gradient_of_the_objective_with_terms_matches_finite_differences(
    solver: TransportSolver, plugins: PluginManager, brdf: str
) -> None:
    """In float64, along random directions of all parameters: pixels, smoothness and terms in both views together."""
    spec = ModelSpec(bounces=1) if brdf == "diffuse" else GLOSSY
    observed = solver._pixels.of(VIEWS)
    start = doubled(solver._initial_parameters(spec, None, observed))
    generator = torch.Generator().manual_seed(1)
    changed = {
        f.name: value + 0.1 * torch.randn(value.shape, generator=generator, dtype=torch.float64)
        for f in fields(start)
        if (value := getattr(start, f.name)) is not None
    }
    weights = {"brightness": 1e3, "brightness_vertex_maps": 1e3, "total_variation": 1e3, "albedo_scale": 1e9}
    terms = terms_of(plugins, {name: {"weight": weight} for name, weight in weights.items()})
    shown = FitTerms(terms, doubled(solver._scene), doubled(solver._transport.surface))
    settings = FitSettings(1, spec.brdf, spec.bounces)  # type: ignore[arg-type]
    prepared = shown.prepared(start, spec.brdf, settings.huber_srgb)
    batch = doubled(solver._pixels.batches(observed, ModelSpec(bounces=1)).make(start.to("cpu"), 0))
    transport = doubled(solver._transport)

    def value(*tensors: Tensor) -> Tensor:
        at = replace(start, **dict(zip(changed, tensors, strict=True)))
        pixels = objective(transport, batch, None, replace(at, specular=None, width=None), settings, solver._edges)
        total = sum((term for term in prepared(at, 0).values()), torch.zeros((), dtype=torch.float64))
        return total + pixels[PIXEL_TERM] + pixels["smoothness"]

    leaves = [tensor.clone().requires_grad_() for tensor in changed.values()]
    whole = value(*leaves)
    parts = prepared(replace(start, **changed), 0)
    shares = {name: float(term) / float(whole.detach()) for name, term in parts.items()}
    assert min(shares.values()) > 0.01, shares
    gradients = torch.autograd.grad(whole, leaves)
    for i, (name, leaf) in enumerate(changed.items()):
        direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64)
        ends = []
        for sign in (1, -1):
            moved = list(changed.values())
            moved[i] = leaf + sign * 1e-6 * direction
            ends.append(float(value(*moved)))
        expected = (ends[0] - ends[1]) / 2e-6
        assert float((gradients[i] * direction).sum()) == pytest.approx(expected, rel=1e-5, abs=1e-9), name


@pytest.mark.parametrize("stop", [7, 12])
def test_an_interrupted_fit_with_terms_ends_with_the_same_bits(
    solver: TransportSolver, plugins: PluginManager, tmp_path: Path, stop: int
) -> None:
    terms = terms_of(plugins, {name: {"weight": 1e4} for name in NAMES})
    settings = FitSettings(20, "dielectric", 0, refresh_interval=5, alpha_frozen_share=0.1)
    observed = solver._pixels.of(VIEWS)
    start = solver._initial_parameters(GLOSSY, None, observed)
    shown = FitTerms(terms, solver._scene, solver._transport.surface)

    def run(checkpoint: FitCheckpoint | None = None, stop: int = -1) -> Parameters:
        def interrupt(step: int, _: float) -> None:
            if step == stop:
                raise KeyboardInterrupt

        batches = solver._pixels.batches(observed, GLOSSY)
        return fit(solver._transport, batches, start, settings, solver._edges, interrupt, checkpoint, shown)

    checkpoint = FitCheckpoint(tmp_path / "fit", -1.0)
    with pytest.raises(KeyboardInterrupt):
        run(checkpoint, stop)
    assert checkpoint.has_state()
    assert_same(run(checkpoint), run())


def test_textures_are_solved_with_the_terms_too(solver: TransportSolver, plugins: PluginManager) -> None:
    """Stripes finer than the vertices, which only the textures have: a variation of great weight removes them."""
    matt = ModelSpec(light_is_known=True)
    values = []
    for weight in (0.0, 30.0, 3e4):
        with_terms = solver.with_terms(terms_of(plugins, {"total_variation": {"weight": weight}}))
        solved = with_terms.scene(fitted(with_terms, matt, ()), VIEWS, silent)  # type: ignore[arg-type]
        refined = with_terms.refine(solved, None, VIEWS, silent)
        assert refined is not None
        term = plugins.create("regularizer", "total_variation").prepare(solved.scene)
        values.append([float(term(each.scene)) for each in (solved, refined)])
    none, little, much = values
    assert none[0] > little[0] > 5 * much[0]
    assert none[1] > little[1] > 5 * much[1], "the refinement with path tracing undoes nothing"


def test_a_proximal_step_solves_a_quadratic_and_is_never_worse() -> None:
    generator = torch.Generator().manual_seed(0)
    start, change = (torch.rand(50, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    target = 0.5 * start + 0.5 * change
    curvature = 10 ** (2 * torch.rand(50, 3, generator=generator, dtype=torch.float64) - 1)
    found = proximal_step(start, curvature, lambda x: 0.5 * (x - target).square().sum())
    expected = (curvature * start + target) / (curvature + 1)
    assert float((found - expected).abs().max()) < 5e-3
    assert torch.equal(proximal_step(start, curvature, lambda x: x.sum() * 0), start)
    assert torch.equal(proximal_step(start, curvature, lambda x: x.sum() * torch.nan), start)
    # a slow part is evaluated at six of the steps, and linear between them
    evaluated = []

    def slow(x: Tensor) -> Tensor:
        evaluated.append(x)
        return 0.25 * (x - target).square().sum()

    found = proximal_step(start, curvature, lambda x: 0.25 * (x - target).square().sum(), slow)
    assert float((found - expected).abs().max()) < 2e-2
    assert len(evaluated) == 6
    assert torch.equal(proximal_step(start, curvature, lambda x: x.sum() * 0, lambda x: x.sum() * torch.nan), start)
    steep = proximal_step(start, curvature, lambda x: 1e6 * (x.mean(dim=0) - 0.5).abs().sum())
    assert float((steep.mean(dim=0) - 0.5).abs().max()) < 0.02 < float((start.mean(dim=0) - 0.5).abs().max())


@pytest.mark.parametrize(("lagged", "of_alpha"), [(True, False), (True, True), (False, False), (False, True)])
def test_the_search_of_a_width_evaluates_only_terms_of_it(
    solver: TransportSolver, lagged: bool, of_alpha: bool
) -> None:
    """Of a lagged term, the gradient that the step takes anyway; the values at the three widths differ as the term."""
    evaluated = []

    def energy(scene: Scene) -> Tensor:
        assert scene.material is not None
        evaluated.append(scene)
        value = scene.material.diffuse_albedo.square().mean()
        return value + scene.material.roughness.mean() if of_alpha else value

    traits = frozenset({"material", "vertex_maps"} | ({"lagged"} if lagged else set()))
    term = WeightedTerm("counted", 2.0, traits, lambda scene: energy)
    uniform = ModelSpec("dielectric", "uniform")
    start = solver._initial_parameters(uniform, None, solver._pixels.of(VIEWS))
    prepared = FitTerms((term,), solver._scene, solver._transport.surface).prepared(start, "dielectric", 0.1)
    assert start.width is not None
    wider = replace(start, width=start.width + 1)
    for step in (15, 30):
        evaluated.clear()
        values = [prepared.of_widths(start, step)(at) for at in (start, wider, start)]
        prepared(start, step)
        expected = 0.2 * float((wider.alpha - start.alpha).mean()) if of_alpha else 0.0
        assert values[1] - values[0] == pytest.approx(expected, rel=1e-4)
        assert values[2] == values[0]
        searches = 1 if step == 15 else 0  # which terms depend on the width is found once
        assert len(evaluated) == (1 if lagged else 1 + searches + 3 * of_alpha)


def test_the_gradients_of_a_lagged_term_add_up_to_those_of_every_step(solver: TransportSolver) -> None:
    """At parameters that stay, five steps have five times the gradient; the value is exact to first order."""

    def energy(scene: Scene) -> Tensor:
        assert scene.material is not None
        return scene.material.diffuse_albedo.square().sum()

    start = solver._initial_parameters(ModelSpec("dielectric", "uniform"), None, solver._pixels.of(VIEWS))
    gradients, values = [], []
    for traits in ({"material", "vertex_maps"}, {"material", "vertex_maps", "lagged"}):
        term = WeightedTerm("square", 2.0, frozenset(traits), lambda scene: energy)
        prepared = FitTerms((term,), solver._scene, solver._transport.surface).prepared(start, "dielectric", 0.1)
        leaf = start.diffuse.clone().requires_grad_()
        for step in range(5):
            prepared(replace(start, diffuse=leaf), step)["regularizer square"].backward()  # type: ignore[no-untyped-call]
        assert leaf.grad is not None
        gradients.append(leaf.grad)
        moved = replace(start, diffuse=start.diffuse + 0.01)
        values.append([float(prepared(at, 4)["regularizer square"].detach()) for at in (start, moved)])
    assert torch.allclose(*gradients, rtol=1e-5)
    assert values[1] == pytest.approx(values[0], rel=1e-3)
    assert values[0][1] > 1.005 * values[0][0]


def test_a_lagged_term_is_evaluated_every_fifth_step(solver: TransportSolver) -> None:
    """In a whole fit with a search of the width, and six times for the albedo in closed form."""
    evaluated = []

    def energy(scene: Scene) -> Tensor:
        assert scene.material is not None
        evaluated.append(scene)
        return scene.material.diffuse_albedo.square().mean()

    term = WeightedTerm("counted", 2.0, frozenset({"material", "vertex_maps", "lagged"}), lambda scene: energy)
    uniform = ModelSpec("dielectric", "uniform")
    observed = solver._pixels.of(VIEWS)
    settings = FitSettings(60, "dielectric", 0, refresh_interval=15)
    shown = FitTerms((term,), solver._scene, solver._transport.surface)
    start = solver._initial_parameters(uniform, None, observed)
    batches = solver._pixels.batches(observed, uniform)
    fit(solver._transport, batches, start, settings, solver._edges, lambda step, loss: None, None, shown)
    assert len(evaluated) == 60 / 5 + 6


def test_one_value_for_the_whole_surface_stays_a_constant(solver: TransportSolver) -> None:
    observed = solver._pixels.of(VIEWS)
    parameters = solver._initial_parameters(ModelSpec("paper", "uniform"), None, observed)
    material = material_at_vertices(parameters, "paper")
    assert material.specular_albedo.shape == (3,) and material.roughness.shape == (1,)
    matt = material_at_vertices(replace(parameters, specular=None, width=None), "diffuse")
    assert isinstance(matt, Material) and float(matt.specular_albedo.max()) == 0


def test_the_initial_width_and_the_diffuse_fit_have_their_own_checkpoints(
    solver: TransportSolver, plugins: PluginManager, tmp_path: Path
) -> None:
    """A finished fit with terms is read again, not computed."""
    with_terms = solver.with_terms(terms_of(plugins, {"brightness_vertex_maps": {"weight": 1e4}}))
    where = CheckpointLocation(tmp_path / "fit", 1e9)
    first = with_terms.fit(ModelSpec(), None, VIEWS, 0.1, silent, where)
    again = solver.fit(ModelSpec(), None, VIEWS, 0.1, silent, where)
    assert_same(first.parameters, again.parameters)
