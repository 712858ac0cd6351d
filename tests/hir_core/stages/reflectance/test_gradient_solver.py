"""A third party's differentiable renderer gets model selection, refinement, checkpoints and terms of the core."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hir_exporters.conventions import latlong_directions

from hir_core.capture import Capture, Pixels, View
from hir_core.config import load_config
from hir_core.errors import ConfigError
from hir_core.optimization.weighted_energies import solver_terms
from hir_core.plugins.interfaces import CheckpointLocation, PreparedReflectance
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_core.stages.reflectance.gradient_fit import object_pixels
from hir_core.stages.reflectance.gradient_solver import GradientSolver
from hir_core.stages.reflectance.path_traced_refinement import view_errors
from hir_core.stages.reflectance.reflectance_fit import fit_reflectance
from hir_core.stages.reflectance.reflectance_report import ReflectanceReport
from tests.fixtures.made_captures import around
from tests.fixtures.scenes import icosphere, looking_at

EXAMPLE = Path(__file__).parents[4] / "examples" / "gallery" / "lambert_sh.py"
PLUGINS = PluginManager.discover((str(EXAMPLE),))
SIZE, TEXELS, VIEWS = 16, 32, 8


def light(frame: Any = "world") -> EnvironmentMap:
    """From above in its frame, with a warm tint."""
    d = torch.from_numpy(latlong_directions(8, 16)).float()
    up = d[..., 1:2] if frame == "world" else -d[..., 1:2]
    return EnvironmentMap((0.6 + 0.5 * up) * torch.tensor([1.0, 0.9, 0.8]), None, frame)


def made(frame: Any = "world") -> tuple[Scene, Capture]:
    """A ball of noise under that light, and eight photographs of it by the example's own formula."""
    mesh, _ = unwrap_mesh(icosphere(2), TEXELS)
    albedo = 0.3 + 0.3 * torch.rand(TEXELS, TEXELS, 3, generator=torch.Generator().manual_seed(0))
    scene = Scene(mesh, Material("paper", albedo, torch.zeros(3), torch.ones(1)), light(frame))
    renderer = PLUGINS.create("reflectance_renderer", "lambert_sh")
    views = []
    for i, eye in enumerate(around(VIEWS)):
        camera = looking_at(eye, SIZE, SIZE)
        image = renderer.render(scene, camera).numpy().astype(np.float32)
        pixels = Pixels(image[..., :3], image[..., 3], np.zeros((SIZE, SIZE), bool))
        views.append(View(str(i), camera, lambda p=pixels: p))  # type: ignore[misc]
    return scene, Capture(Path("made"), tuple(views))


def start_of(scene: Scene) -> Scene:
    grey = Material("paper", torch.full((TEXELS, TEXELS, 3), 0.5), torch.zeros(3), torch.ones(1))
    return replace(scene, material=grey, environment=EnvironmentMap(torch.full((8, 16, 3), 0.5)))


def fitted(tmp_path: Path, scene: Scene, capture: Capture, **settings: Any) -> tuple[Scene, ReflectanceReport]:
    options = {"reflectance_renderer": {"lambert_sh": {"steps": 60}}}
    context = StageContext(PLUGINS, tmp_path, options)
    given: dict[str, Any] = {
        "renderer": "lambert_sh",
        "environment_height": 8,
        "environment_width": 16,
        "path_tracing": {"renderer": "lambert_sh", "refine_albedo": False},
    }
    chosen = load_config(PLUGINS, "fast", reflectance=given | settings).reflectance
    found = fit_reflectance(start_of(scene), capture, chosen, context)
    return found.scene, found.report


@pytest.mark.parametrize("frame", [pytest.param("world", marks=pytest.mark.slow), "camera"])
def test_the_frame_of_the_light_is_selected_on_held_out_views(tmp_path: Path, frame: str) -> None:
    """Diffuse under a light in the world against diffuse under a light on the camera; no other model is fitted."""
    scene, report = fitted(tmp_path, *made(frame))
    assert report.method == "solver" and report.light_frame == frame
    assert scene.environment is not None and scene.environment.frame == frame
    document = report.as_document()
    compared = {(each["kind"], each["light_frame"]) for each in document["hypotheses"]}
    assert compared == {("diffuse", "world"), ("diffuse", "camera")}


def silent(share: float) -> None:
    """Ignores the progress."""


def solver_of(scene: Scene, capture: Capture, steps: int = 40) -> GradientSolver:
    renderer = PLUGINS.create("reflectance_renderer", "lambert_sh", {"steps": steps})
    solver: GradientSolver = renderer.prepare(start_of(scene), capture)
    return solver


class Interrupted(PreparedReflectance):
    """A renderer that is interrupted at one of its calls."""

    def __init__(self, inner: PreparedReflectance, call: int) -> None:
        self._inner, self._left = inner, call

    def radiance(self, material: Material, environment: EnvironmentMap, pixels: torch.Tensor) -> torch.Tensor:
        self._left -= 1
        if self._left == 0:
            raise KeyboardInterrupt
        return self._inner.radiance(material, environment, pixels)


def assert_same(one: Scene, other: Scene) -> None:
    assert one.material is not None and other.material is not None
    assert one.environment is not None and other.environment is not None
    assert torch.equal(one.material.diffuse_albedo, other.material.diffuse_albedo)
    assert torch.equal(one.environment.radiance, other.environment.radiance)


def test_a_finished_fit_is_read_again_and_an_interrupted_one_ends_with_the_same_bits(tmp_path: Path) -> None:
    scene, capture = made()
    solver = solver_of(scene, capture)
    where = CheckpointLocation(tmp_path / "fit", -1.0)
    whole = solver.fit(ModelSpec(), None, range(6), 1.0, silent)
    broken = GradientSolver(Interrupted(solver, 15), start_of(scene), capture, steps=40)
    with pytest.raises(KeyboardInterrupt):
        broken.fit(ModelSpec(), None, range(6), 1.0, silent, where)
    assert (tmp_path / "fit.state.npz").exists()
    resumed = solver.fit(ModelSpec(), None, range(6), 1.0, silent, where)
    assert_same(resumed.scene, whole.scene)
    assert [path.name for path in tmp_path.iterdir()] == ["fit.npz"]
    again = GradientSolver(Interrupted(solver, 1), start_of(scene), capture, steps=40)
    assert_same(again.fit(ModelSpec(), None, range(6), 1.0, silent, where).scene, whole.scene)


class Brighter(PreparedReflectance):
    """A reference that shows more than the renderer: light from elsewhere."""

    def __init__(self, inner: PreparedReflectance) -> None:
        self._inner = inner

    def radiance(self, material: Material, environment: EnvironmentMap, pixels: torch.Tensor) -> torch.Tensor:
        shown = self._inner.radiance(material, environment, pixels)
        return shown + 0.05 * (shown > 0)


def test_the_albedo_is_refined_under_a_reference_renderer() -> None:
    """A reference that is brighter by a constant asks for a darker albedo; the light stays."""
    scene, capture = made()
    solver = solver_of(scene, capture)
    solved = solver.scene(solver.fit(ModelSpec(), None, range(VIEWS), 1.0, silent), range(VIEWS), silent)
    reference = Brighter(solver)
    refined = solver.refine(solved, reference, range(VIEWS), silent)
    assert refined is not None
    before, after = (
        view_errors(each.scene, reference, capture, [object_pixels(capture, [1], 1, "cpu")], 0)[0]
        for each in (solved, refined)
    )
    assert after < 0.3 * before
    assert solved.scene.environment is not None and refined.scene.environment is not None
    assert torch.equal(solved.scene.environment.radiance, refined.scene.environment.radiance)


def test_terms_shape_the_fit() -> None:
    solver = solver_of(*made())
    plain = solver.fit(ModelSpec(), None, range(VIEWS), 1.0, silent)
    terms = solver_terms({"total_variation": {"weight": 1e5}}, PLUGINS, 0, {})
    smooth = solver.with_terms(terms).fit(ModelSpec(), None, range(VIEWS), 1.0, silent)
    term = PLUGINS.create("regularizer", "total_variation").prepare(plain.scene)
    assert float(term(smooth.scene)) < 0.3 * float(term(plain.scene))


def test_a_model_that_the_renderer_does_not_show_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"does not fit 'dielectric, specular'; choose another reflectance.renderer"):
        fitted(tmp_path, *made(), model="specular")


def test_the_harmonics_give_the_irradiance_of_a_uniform_and_of_a_linear_light() -> None:
    """π for a light of 1; of `1 + d·a` π + 2π/3 n·a."""
    module = sys.modules["hir_plugin_lambert_sh"]
    d = torch.from_numpy(latlong_directions(64, 128)).double()
    slope = torch.tensor([0.3, -0.2, 0.4], dtype=torch.float64)
    normal = torch.nn.functional.normalize(torch.randn(9, 3, dtype=torch.float64), dim=1)
    found = module.irradiance((1 + d @ slope)[..., None].expand(-1, -1, 3), normal)
    expected = np.pi + 2 * np.pi / 3 * (normal @ slope)
    assert torch.allclose(found, expected[:, None].expand(-1, 3), rtol=2e-3)
