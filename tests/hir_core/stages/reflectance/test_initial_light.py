"""The light that a fit starts from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages.reflectance.initial_material_and_light import INITIAL_MEAN_ALBEDO, initial_radiance, initial_scene
from tests.fixtures.made_captures import BROWN, around, ball, lamps, make_material, photographs
from tests.hir_core.stages.reflectance.test_light_scale import measured_capture


def made(albedo: float = 0.6, radiance: float = 1.0) -> Capture:
    """Photographs of a matt ball under constant light."""
    light = EnvironmentMap(torch.full((8, 16, 3), radiance))
    return photographs(Scene(ball(), make_material((albedo,) * 3), light), around(9))


@pytest.mark.parametrize(("albedo", "radiance"), [(0.6, 1.0), (0.1, 1.0), (0.6, 0.2)])
def test_the_mean_colour_is_that_of_the_expected_albedo(albedo: float, radiance: float) -> None:
    """Photographs show the product of albedo and light alone."""
    found = initial_radiance(made(albedo, radiance), ReflectanceSettings(), by_solver=True)
    assert found * INITIAL_MEAN_ALBEDO == pytest.approx(albedo * radiance, rel=0.05)


def test_the_setting_replaces_it() -> None:
    capture = made()
    settings = ReflectanceSettings(initial_radiance=0.2)
    assert initial_radiance(capture, settings, by_solver=True) == 0.2
    assert initial_radiance(capture, settings, by_solver=False) == 0.2
    assert initial_radiance(capture, ReflectanceSettings(), by_solver=False) == 0.5


def test_a_gain_of_photographs_is_no_light() -> None:
    capture = made()
    dimmed = replace(capture, views=tuple(replace(view, exposure=0.5) for view in capture.views))
    found = [initial_radiance(each, ReflectanceSettings(), True) for each in (capture, dimmed)]
    assert found[1] == pytest.approx(2 * found[0], rel=1e-5)


def test_black_photographs_give_a_finite_light() -> None:
    found = initial_radiance(made(radiance=0.0), ReflectanceSettings(), by_solver=True)
    assert np.isfinite(found) and found > 0


def test_a_card_says_how_bright_the_light_is() -> None:
    truth = Scene(ball(), make_material(BROWN), lamps())
    capture: Any = measured_capture(truth, 9)
    material = Material("dielectric", torch.full((8, 8, 3), 0.5), torch.full((3,), 0.04), torch.tensor([0.2]))
    start = initial_scene(replace(truth, material=material), capture, ReflectanceSettings())
    assert start.environment is not None
    expected = torch.tensor(capture.irradiance.mean) / np.pi
    torch.testing.assert_close(start.environment.radiance[0, 0], expected.to(start.environment.radiance))
