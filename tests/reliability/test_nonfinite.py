"""NaN at every point of a fit: detected in its step, reported with term, view and vertices, skipped, counted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hir_core.capture import Capture, Pixels, View
from hir_core.config import GeometrySettings, GradientSettings, ReflectanceSettings
from hir_core.errors import HirError, StageError
from hir_core.optimization.checkpoints import load_checkpoint
from hir_core.optimization.optimization_loop import MAX_CONSECUTIVE_NONFINITE_STEPS, Checkpointing, optimize
from hir_core.optimization.schedules import Schedule
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.photographs import masked_photograph
from hir_core.run.stage_context import StageContext
from hir_core.scene import Material, Scene
from hir_core.scene.frames import unit_similarity
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.stages.reflectance.gradient_fit import fit_by_gradient, object_pixels
from hir_core.stages.reflectance.initial_material_and_light import initial_scene
from hir_core.testing.captures import tiny_capture
from hir_core.testing.scenes import sphere
from hir_plugins.geometry_renderers.contour import Contour

SETTINGS = GeometrySettings(
    renderer="contour",
    iterations=30,
    levels=1,
    triangles=600,
    photo_consistency="off",
    outline_iterations=25,
    parameterization="vertices",
    held_out=0.0,
    prune=False,
    regularizers={"laplacian": {"weight": 0.1}},
)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return tiny_capture(tmp_path_factory.mktemp("tiny"), views=8, size=48).capture


@pytest.fixture
def context(tmp_path: Path) -> tuple[StageContext, list[str]]:
    warnings: list[str] = []
    return StageContext(PluginManager.discover(), tmp_path, warn=warnings.append), warnings


def test_a_value_of_one_view_is_named(
    capture: Capture, context: tuple[StageContext, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The area of the third view is always NaN: each step with this view is skipped, the others are fitted."""
    plain = Contour.overlap
    bad = capture.views[2]

    def overlap(self: Contour, mesh: Any, targets: Any) -> Any:
        area, inner = plain(self, mesh, targets)
        sick = torch.tensor([c.world_to_camera[0, 3] for c in targets.cameras]).isclose(torch.tensor(marks[2]))
        return torch.where(sick, torch.nan, area), inner

    scene = Scene(sphere(radius=1.3))
    moved = capture.transformed(unit_similarity(scene.mesh))
    marks = [v.camera.world_to_camera[0, 3] for v in moved.views if v.camera is not None]
    monkeypatch.setattr(Contour, "overlap", overlap)
    settings = replace(SETTINGS, views_per_step=2)
    fitted, report = fit_geometry(scene, capture, settings, context[0])
    level = report.levels[0]
    assert 5 <= level.skipped_steps["silhouette"] <= 10, "one step in four draws that view"
    assert any(f"view {bad.name}" in w and "silhouette is not finite" in w for w in context[1])
    assert bool(torch.isfinite(fitted.scene.mesh.positions).all())


def test_a_gradient_at_some_vertices_is_named(
    capture: Capture, context: tuple[StageContext, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Contour.overlap
    calls = 0

    def overlap(self: Contour, mesh: Any, targets: Any) -> Any:
        nonlocal calls
        area, inner = plain(self, mesh, targets)
        if mesh.positions.requires_grad:
            calls += 1
            if calls in (4, 5, 6, 7):  # a step, then the questions of what was wrong with it
                zero = (mesh.positions[[3, 7]] - mesh.positions[[3, 7]].detach()).square().sum()
                area = area + zero.sqrt()  # 0, with a slope of 0/0
        return area, inner

    monkeypatch.setattr(Contour, "overlap", overlap)
    fitted, report = fit_geometry(Scene(sphere(radius=1.3)), capture, replace(SETTINGS, views_per_step=2), context[0])
    assert report.levels[0].skipped_steps["silhouette"] >= 1
    assert any("vertices 3, 7" in w for w in context[1]), context[1]
    assert bool(torch.isfinite(fitted.scene.mesh.positions).all())


def test_a_regularizer_is_named(
    capture: Capture, context: tuple[StageContext, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hir_plugins.regularizers.laplacian import Laplacian

    plain = Laplacian.prepare

    def prepare(self: Laplacian, scene: Scene) -> Any:
        energy, calls = plain(self, scene), [0]

        def sick(scene: Scene) -> torch.Tensor:
            calls[0] += 1
            return energy(scene) * (torch.nan if calls[0] in (10, 11) else 1.0)

        return sick

    monkeypatch.setattr(Laplacian, "prepare", prepare)
    _, report = fit_geometry(Scene(sphere(radius=1.3)), capture, SETTINGS, context[0])
    assert report.levels[0].skipped_steps == {"laplacian": 1}
    assert any("step 9: laplacian is not finite" in w for w in context[1]), context[1]


def test_a_mask_of_nan_is_refused_with_its_view(capture: Capture, context: tuple[StageContext, list[str]]) -> None:
    views = list(capture.views)
    mask = np.array(views[1].read().mask)
    mask[5, 5] = np.nan
    views[1] = replace(views[1], mask=mask)
    with pytest.raises(HirError, match=f"view {views[1].name}"):
        fit_geometry(Scene(sphere(radius=1.3)), replace(capture, views=tuple(views)), SETTINGS, context[0])


def _sick_photograph(view: View) -> View:
    pixels = view.read()
    color = np.array(pixels.color_linear)
    rows, columns = np.nonzero(pixels.mask >= 0.99)
    middle = len(rows) // 2
    color[rows[middle : middle + 7], columns[middle : middle + 7]] = np.nan
    return replace(view, read=lambda: Pixels(color, pixels.mask, pixels.saturated))


def test_a_photograph_of_nan_is_named_or_its_pixels_left_out(
    capture: Capture, context: tuple[StageContext, list[str]]
) -> None:
    from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import observe_pixels
    from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import build_transport

    views = list(capture.views)
    views[3] = _sick_photograph(views[3])
    sick = replace(capture, views=tuple(views))
    with pytest.raises(StageError, match=f"view {views[3].name} has 7 pixels"):
        object_pixels(sick, list(range(8)), 1, "cpu")
    shown = masked_photograph(views[3])
    lost = np.isnan(views[3].pixels().color_linear).any(axis=2)
    assert lost.sum() == 7 and not shown.mask[lost].any() and np.isfinite(shown.picture).all()
    transport = build_transport(sphere(), 500, 100, (4, 8), 4, "cpu")
    with pytest.warns(UserWarning, match=f"view {views[3].name}: "):
        found = observe_pixels(transport, sick, 3, 10_000, 1, 0)
    assert bool(torch.isfinite(found.color).all())


class Lamp:
    """A prepared renderer of one line: the albedo under the mean of the light; NaN on request."""

    def __init__(self, sick: Callable[[int], bool], views: tuple[int, ...] = ()) -> None:
        self.calls, self._sick, self._views = 0, sick, views

    def radiance(self, material: Material, environment: Any, pixels: torch.Tensor) -> torch.Tensor:
        self.calls += 1
        flat = material.diffuse_albedo.reshape(-1, 3)
        color = flat[pixels[:, 1] % len(flat)] * environment.radiance.mean()
        if not self._sick(self.calls):
            return color
        bad = (
            torch.isin(pixels[:, 0], torch.tensor(self._views)) if self._views else torch.ones(len(pixels), dtype=bool)
        )
        return torch.where(bad[:, None], torch.nan, color)


def _fit(capture: Capture, context: StageContext, lamp: Lamp, poison: str = "") -> tuple[Scene, GradientReport]:
    settings = ReflectanceSettings(method="gradient", model="specular", environment_height=4, environment_width=8)
    scene = _scene_with_texture()
    scene = initial_scene(scene, capture, settings)
    if poison:
        assert scene.material is not None
        texture = scene.material.diffuse_albedo.clone()
        texture[1, 2, 0] = torch.nan
        scene = replace(scene, material=replace(scene.material, diffuse_albedo=texture))
    pixels = object_pixels(capture, list(range(8)), 1, "cpu")
    from hir_core.optimization.weighted_energies import prepare_energies

    energies = prepare_energies(scene, {}, context.plugins)
    return fit_by_gradient(scene, lamp, pixels, GradientSettings(batch_pixels=256), energies, context, steps=40)  # type: ignore[arg-type]


def _scene_with_texture() -> Scene:
    mesh = sphere()
    uvs = torch.rand(len(mesh.positions), 2, generator=torch.Generator().manual_seed(0))
    mesh = replace(mesh, uvs=uvs, topology=replace(mesh.topology, uv_faces=mesh.faces))
    texture = torch.full((8, 8, 3), 0.5)
    return Scene(mesh, Material("dielectric", texture, torch.full((3,), 0.04), torch.full((1,), 0.2)))


def test_a_view_of_the_reflectance_fit_is_named(capture: Capture, context: tuple[StageContext, list[str]]) -> None:
    lamp = Lamp(lambda call: call in (10, 11), views=(5,))
    fitted, report = _fit(capture, context[0], lamp)
    assert report.skipped == {"rgb": 1}
    assert any("step 9: rgb is not finite" in w and "of view 5" in w for w in context[1]), context[1]
    assert fitted.material is not None and bool(torch.isfinite(fitted.material.diffuse_albedo).all())


def test_a_texture_of_nan_stops_the_stage_and_is_named(
    capture: Capture, context: tuple[StageContext, list[str]]
) -> None:
    with pytest.raises(StageError, match=rf"{MAX_CONSECUTIVE_NONFINITE_STEPS} steps in a row"):
        _fit(capture, context[0], Lamp(lambda _: False), poison="texture")


def test_persistent_nonfinite_gradients_keep_the_last_finite_state(tmp_path: Path) -> None:
    x = torch.tensor([3.0], requires_grad=True)
    optimizer = torch.optim.Adam([x], 0.1)
    good: list[float] = []

    def loss(step: int) -> dict[str, torch.Tensor]:
        if step < 15:
            good.append(x.item())
        return {"far": (x - 1).square().sum() * (1.0 if step < 15 else torch.nan)}

    with pytest.raises(StageError, match="because of 'far'"):
        optimize(loss, optimizer, Schedule(100), stage="test", checkpointing=Checkpointing(tmp_path / "a.npz", 1e9))
    y = torch.tensor([0.0], requires_grad=True)
    found = load_checkpoint(tmp_path / "a.npz", torch.optim.Adam([y], 0.1))
    assert found is not None and found[0] == 15
    assert y.item() == x.item() and y.item() not in good, "the state after the fifteenth step"
