"""Path-traced refinement is accepted where held-out views gain, and rejected where they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Capture, Pixels, View
from hir_core.config import GradientSettings, PathTracingSettings, ReflectanceSettings
from hir_core.optimization.weighted_energies import Energies
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages.reflectance.path_traced_refinement import refine_by_path_tracing
from hir_core.stages.reflectance.reflectance_report import RefinementReport
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from tests.fixtures.scenes import icosphere, looking_at

SIZE, VIEWS = 20, 9


@pytest.fixture(scope="module")
def observe_pixels() -> tuple[Capture, Scene]:
    """A glossy ball from nine sides, path traced, and the scene that it is of."""
    light = 0.5 + 0.4 * texel_directions(8, 16)[:, 1:2] + 0.2 * texel_directions(8, 16)[:, :1]
    sky = EnvironmentMap(light.expand(-1, 3).reshape(8, 16, 3).contiguous())
    material = Material("dielectric", torch.tensor([0.5, 0.3, 0.2]), torch.full((3,), 0.1), torch.tensor([0.3]))
    scene = Scene(icosphere(3), material, sky)
    cameras = [
        looking_at((4 * np.sin(a), 1.0, 4 * np.cos(a)), SIZE, SIZE)
        for a in np.linspace(0, 2 * np.pi, VIEWS, endpoint=False)
    ]
    nothing = np.zeros((SIZE, SIZE), bool)
    empty = Pixels(np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), nothing)
    blank = Capture(Path("made"), tuple(View(str(i), c, lambda: empty) for i, c in enumerate(cameras)))
    tracer = MitsubaGGX(MitsubaGGXOptions(samples=256)).prepare(scene, blank)
    grid = torch.tensor([(v, x, y) for v in range(VIEWS) for y in range(SIZE) for x in range(SIZE)])
    radiance = tracer.radiance(material, sky, grid).reshape(VIEWS, SIZE, SIZE, 3).numpy()
    views = []
    for i, camera in enumerate(cameras):
        pixels = Pixels(radiance[i], (radiance[i].sum(axis=2) > 0).astype(np.float32), nothing)
        views.append(View(str(i), camera, lambda pixels=pixels: pixels))  # type: ignore[misc]
    return Capture(Path("made"), tuple(views)), scene


def run(capture: Capture, scene: Scene, folder: Path, rate: float) -> tuple[Scene, RefinementReport, list[str]]:
    warnings: list[str] = []
    context = StageContext(PluginManager.discover(), folder, warn=warnings.append)
    settings = ReflectanceSettings(
        gradient=GradientSettings(batch_pixels=1024),
        path_tracing=PathTracingSettings("mitsuba_ggx", iterations=25, learning_rate=rate),
    )
    fitted, report = refine_by_path_tracing(scene, capture, settings, Energies({}), context)
    return fitted, report, warnings


@pytest.mark.slow
def test_a_gain_is_accepted(observe_pixels: tuple[Capture, Scene], tmp_path: Path) -> None:
    capture, truth = observe_pixels
    assert truth.material is not None
    dull = replace(truth.material, diffuse_albedo=truth.material.diffuse_albedo * 0.85)
    fitted, report, warnings = run(capture, replace(truth, material=dull), tmp_path, 0.01)
    assert report.accepted and not warnings
    assert report.gain_db is not None and report.before_db is not None and report.after_db is not None
    assert report.gain_db > 2 and report.after_db > report.before_db and report.steps == 25
    assert report.held_out_views == 8 and not report.near_tie, "four of nine views judge in each of two folds"
    assert fitted.material is not None
    assert float((fitted.material.diffuse_albedo - dull.diffuse_albedo).min()) > 0


def test_a_loss_is_rejected(observe_pixels: tuple[Capture, Scene], tmp_path: Path) -> None:
    capture, truth = observe_pixels
    fitted, report, warnings = run(capture, truth, tmp_path, 0.3)
    assert not report.accepted and fitted is truth
    assert len(warnings) == 1 and "without it was kept" in warnings[0]


def test_too_few_views_skip_the_refinement(observe_pixels: tuple[Capture, Scene], tmp_path: Path) -> None:
    capture, truth = observe_pixels
    fitted, report, warnings = run(replace(capture, views=capture.views[:4]), truth, tmp_path, 0.01)
    assert fitted is truth and not report.accepted and "too few views" in warnings[0]
