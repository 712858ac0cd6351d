"""Total variation and the scale guard: definition, gradients, hard inputs; terms act or say that they do not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_core.capture import Capture, Pixels, View
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_core.stages.atlas import unwrap_mesh
from hir_core.stages.reflectance.reflectance_fit import fit_reflectance
from hir_plugins.regularizers.albedo_scale import AlbedoScale
from hir_plugins.regularizers.material_options import AlbedoScaleOptions, TotalVariationOptions
from hir_plugins.regularizers.mesh_variation import mesh_variation
from hir_plugins.regularizers.total_variation import TotalVariation, environment_variation, texture_variation
from tests.fixtures.made_captures import (
    around,
    ball,
    checked,
    fitted,
    lamps,
    make_material,
    photographs,
    reflectance_settings,
)
from tests.fixtures.scenes import icosphere, looking_at, square


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
    make_material = Material(
        "paper", torch.rand(8, 8, 3).double(), torch.rand(8, 8, 3).double(), torch.rand(4, 4, 1).double()
    )
    scene = Scene(square(), make_material, EnvironmentMap(torch.rand(4, 8, 3).double()))
    energy = TotalVariation(TotalVariationOptions(environment=0.5)).prepare(scene)

    def value(diffuse: torch.Tensor, roughness: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        there = replace(make_material, diffuse_albedo=diffuse, roughness=roughness)
        return energy(replace(scene, material=there, environment=EnvironmentMap(light)))

    assert scene.environment is not None
    leaves = [
        t.clone().requires_grad_()
        for t in (make_material.diffuse_albedo, make_material.roughness, scene.environment.radiance)
    ]
    assert torch.autograd.gradcheck(value, leaves, eps=1e-7, rtol=1e-5)


def grid(cells: int) -> Mesh:
    """A square of side 2 in the plane y = 0 of so many cells a side, with texture coordinates."""
    ticks = torch.linspace(-1, 1, cells + 1, dtype=torch.float64)
    z, x = torch.meshgrid(ticks, ticks, indexing="ij")
    index = torch.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (i.reshape(-1) for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)])
    positions = torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3)
    return Mesh(positions, Topology(faces, faces), (positions[:, [0, 2]] + 1) / 2)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("cells", [1, 7])
def test_variation_over_triangles_is_the_slope_times_the_area(cells: int, size: float) -> None:
    """f = 3x/s on a square of side 2s, whatever triangles it has: ∫|∇f| dA / √A = 3·4s/2s, in both channels."""
    mesh = grid(cells)
    ramp = 3 * mesh.positions[:, [0]]
    ramp = torch.cat([ramp, -ramp], dim=1)
    value = float(mesh_variation(size * mesh.positions, mesh.faces, ramp))
    assert value == pytest.approx(2 * 3 * 4 / 2, rel=1e-12)


def test_variation_over_triangles_hears_a_step_across_a_seam() -> None:
    """Two charts of one colour each: no two texels of a chart differ, but the surface has an edge between them."""
    mesh, _ = unwrap_mesh(icosphere(2), 64)
    north = (mesh.positions[:, 1] > 0.1).double()
    values = north[:, None].expand(-1, 3)
    edge = float(mesh_variation(mesh.positions, mesh.faces, values))
    # a step of 1 along the equator of a unit sphere, in three channels: 3·2π/√(4π), longer on jagged triangles
    assert 1.0 < edge / (3 * 2 * math.pi / math.sqrt(4 * math.pi)) < 1.5


def test_variation_over_triangles_without_area_is_nothing_and_finite() -> None:
    for positions in (torch.zeros(3, 3), torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])):
        values = torch.rand(3, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
        value = mesh_variation(positions, torch.tensor([[0, 1, 2]]), values)
        (gradient,) = torch.autograd.grad(value, values)
        assert float(value.detach()) == 0
        assert not gradient.any()


def test_variation_at_vertices_matches_finite_differences_and_is_0_where_flat() -> None:
    torch.manual_seed(0)
    make_material = Material(
        "paper", torch.rand(8, 8, 3).double(), torch.rand(8, 8, 3).double(), torch.rand(4, 4, 1).double()
    )
    scene = Scene(grid(5), make_material)
    energy = TotalVariation(TotalVariationOptions(samples="vertices")).prepare(scene)

    def value(diffuse: Tensor, roughness: Tensor) -> Tensor:
        return energy(replace(scene, material=replace(make_material, diffuse_albedo=diffuse, roughness=roughness)))

    leaves = [t.clone().requires_grad_() for t in (make_material.diffuse_albedo, make_material.roughness)]
    assert torch.autograd.gradcheck(value, leaves, eps=1e-7, rtol=1e-5)
    flat = Material("paper", *(torch.full((8, 8, c), 0.3).double().requires_grad_() for c in (3, 3, 1)))
    nothing = energy(replace(scene, material=flat))
    assert float(nothing.detach()) == 0
    assert not torch.autograd.grad(nothing, flat.diffuse_albedo)[0].any()


def test_a_variation_of_constants_alone_causes_a_warning() -> None:
    constant = Material("paper", torch.rand(3), torch.rand(3), torch.rand(1))
    with pytest.warns(UserWarning, match="has no effect"):
        TotalVariation(TotalVariationOptions()).prepare(Scene(square(), constant))


def guarded(texture: Tensor, per_channel: bool = False) -> tuple[Scene, AlbedoScale]:
    return Scene(square(), Material("paper", texture, torch.zeros(3), torch.ones(1))), AlbedoScale(
        AlbedoScaleOptions(per_channel)
    )


def test_the_scale_guard_costs_the_square_of_the_logarithm_of_the_factor() -> None:
    texture = 0.2 + 0.3 * torch.rand(8, 8, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    scene, guard = guarded(texture)
    energy = guard.prepare(scene)
    assert scene.material is not None

    def at(other: Tensor, term: Any = energy) -> float:
        assert scene.material is not None
        return float(term(replace(scene, material=replace(scene.material, diffuse_albedo=other))))

    assert at(texture) == 0
    for factor in (0.5, 1.5):
        assert at(factor * texture) == pytest.approx(math.log(factor) ** 2, rel=1e-2)
    assert at(texture.flip(0)) == pytest.approx(0, abs=1e-20), "where the albedo is, is no matter of the scale"
    tinted = texture * torch.tensor([1.2, 1.0, 0.8], dtype=torch.float64)
    tinted = tinted * (texture.mean() / tinted.mean())
    assert at(tinted) == pytest.approx(0, abs=1e-20)
    assert at(tinted, AlbedoScale(AlbedoScaleOptions(per_channel=True)).prepare(scene)) > 1e-3


@pytest.mark.parametrize("per_channel", [False, True])
def test_scale_guard_gradients_match_finite_differences(per_channel: bool) -> None:
    texture = torch.rand(6, 6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    scene, guard = guarded(texture, per_channel)
    energy = guard.prepare(scene)

    def value(other: Tensor) -> Tensor:
        assert scene.material is not None
        return energy(replace(scene, material=replace(scene.material, diffuse_albedo=other)))

    assert torch.autograd.gradcheck(value, [(0.7 * texture).requires_grad_()], eps=1e-7, rtol=1e-5)


@pytest.mark.parametrize("shape", [(3,), (1, 1, 3), (8, 8, 3)])
def test_the_scale_guard_of_black_is_finite(shape: tuple[int, ...]) -> None:
    scene, guard = guarded(torch.zeros(shape, requires_grad=True))
    assert scene.material is not None
    value = guard.prepare(scene)(scene)
    (gradient,) = torch.autograd.grad(value, scene.material.diffuse_albedo)
    assert float(value.detach()) == 0
    assert torch.isfinite(gradient).all()


PLUGINS = PluginManager.discover()
TERMS: Mapping[str, Mapping[str, Any]] = {
    "total_variation": {"weight": 300.0},
    "joint_bilateral": {"weight": 3e4, "samples": "texels", "sigma_position": 0.1},
    "bilateral_specular": {"weight": 30.0, "samples": "texels", "sigma_position": 0.1, "sigma_albedo": 1.0},
}


def small_fit(tmp_path: Path, warnings: list[str], **settings: Any) -> Scene:
    """A ball of 32² texels in three photographs of noise, fitted in a few steps."""
    random = np.random.default_rng(0)
    eyes = [(0.0, 0.5, 4.0), (4.0, 0.5, 0.0), (-3.0, 1.0, -3.0)]

    def view(eye: tuple[float, float, float]) -> View:
        y, x = np.mgrid[:24, :24]
        mask = (np.hypot(x - 11.5, y - 11.5) < 7).astype(np.float32)
        pixels = Pixels(random.uniform(0.1, 0.6, (24, 24, 3)).astype(np.float32), mask, np.zeros((24, 24), bool))
        return View(str(eye), looking_at(eye, 24, 24), lambda: pixels)

    mesh, _ = unwrap_mesh(icosphere(2), 32)
    noise = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(1))
    start = Scene(mesh, Material("paper", 0.3 + 0.3 * noise, torch.zeros(3), torch.ones(1)))
    options = {
        "transport_ggx": {"steps": 4, "cache_cells": 200, "vertices": 500, "pixels": 600, "texture_pixels": 1000},
        "mitsuba_ggx": {"samples": 4},
    }
    context = StageContext(PLUGINS, tmp_path, {"reflectance_renderer": options}, warn=warnings.append)
    gradient = {"iterations": 20, "learning_rate_end": 0.02} | settings.pop("gradient", {})
    given = {"environment_height": 8, "environment_width": 16, "gradient": gradient, **settings}
    torch.manual_seed(0)
    capture = Capture(Path("made"), tuple(view(eye) for eye in eyes))
    fitted = fit_reflectance(start, capture, reflectance_settings(**given), context).scene
    return fitted


WAYS = [("mitsuba_ggx", "gradient"), ("transport_ggx", "gradient"), ("transport_ggx", "solver")]
QUICK = {("bilateral_specular", "mitsuba_ggx", "gradient"), ("total_variation", "transport_ggx", "solver")}


@pytest.mark.parametrize(
    ("name", "renderer", "method"),
    [
        pytest.param(name, *way, marks=[] if (name, *way) in QUICK else pytest.mark.slow)
        for name in sorted(TERMS)
        for way in WAYS
        # the bilateral terms in the solver have a test of their own: four steps change the specular map too little
        if way[1:] != ("solver",) or name == "total_variation"
    ],
)
def test_a_term_of_the_settings_acts(name: str, renderer: str, method: str, tmp_path: Path) -> None:
    """In gradient steps of both renderers, and inside the solver: a term falls far below its value without it."""
    given = {"renderer": renderer, "method": method, "model": "specular_map"}
    plain = small_fit(tmp_path / "plain", [], **given, regularizers={"total_variation": {"weight": 1e-9}})
    warnings_seen: list[str] = []
    # a solver compares the term with all pixels, gradient steps with those of a few
    weight = TERMS[name]["weight"] * (100 if method == "solver" else 1)
    smooth = small_fit(
        tmp_path / "term", warnings_seen, **given, regularizers={name: {**TERMS[name], "weight": weight}}
    )
    options = {key: value for key, value in TERMS[name].items() if key != "weight"}
    term = PLUGINS.create("regularizer", name, options).prepare(plain)
    assert float(term(smooth)) < 0.6 * float(term(plain))
    assert not [text for text in warnings_seen if "no effect" in text]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bilateral_specular", "joint_bilateral"])
def test_the_solver_smooths_the_specular_map(name: str, tmp_path: Path) -> None:
    """Checks of ρs .02 and .42 under a known light: the map is flat, and the part of the term that belongs to it falls
    far below its value without the term. The diffuse albedo then shows the checks, as the photographs do.
    """
    mesh = ball()
    truth = Scene(mesh, make_material((0.3, 0.2, 0.1), checked(mesh, 0.02, 0.42).expand(-1, -1, 3), 0.2), lamps())
    capture = photographs(truth, around(8))
    plain, smooth = (
        fitted(
            mesh,
            capture,
            tmp_path / str(weight),
            light=lamps(),
            model="specular_map",
            brdf="paper",
            options={"steps": 40, "cache_cells": 200},
            regularizers={name: {"weight": weight}},
        )[0]
        for weight in (1e-9, 1e4)
    )
    of_specular = {"diffuse_albedo": 0.0} if name == "joint_bilateral" else {}
    term = PLUGINS.create("regularizer", name, of_specular).prepare(plain)
    assert float(term(smooth)) < 0.6 * float(term(plain))
    before, after = (observed_specular(scene).std() for scene in (plain, smooth))
    assert after < 0.6 * before


def observed_specular(scene: Scene) -> Tensor:
    """The specular albedo of the texels that photographs show."""
    assert scene.material is not None and scene.material.observed is not None
    return scene.material.specular_albedo[scene.material.observed]


def test_a_term_that_cannot_act_causes_a_warning(tmp_path: Path) -> None:
    warnings_seen: list[str] = []
    terms = {"bilateral_specular": {"weight": 1.0}}
    small_fit(tmp_path / "constant", warnings_seen, model="specular", regularizers=terms)
    assert any("bilateral_specular has no effect" in text for text in warnings_seen)
    warnings_seen.clear()
    terms = {"edge_length": {"weight": 1.0}}
    small_fit(tmp_path / "mesh", warnings_seen, model="diffuse", regularizers=terms)
    assert any("edge_length depends on neither material nor light" in text for text in warnings_seen)
