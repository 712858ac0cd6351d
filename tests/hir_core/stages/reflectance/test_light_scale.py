"""A card of known reflectance fixes the scale between albedo and light."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hir_exporters.light.environment_map import harmonic_basis, irradiance_harmonics

from hir_core.capture.measured_irradiance import MeasuredIrradiance
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.card_irradiance import card_irradiance, measured_over_found
from hir_core.stages.reflectance.light_scale import ASSUMED, LightScaleReport, disagreement_warning, light_scale_report
from tests.fixtures.made_captures import BROWN, around, ball, fitted, lamps, make_material, photographs

UP = (0.0, 1.0, 0.0)
TILTED = (0.6, 0.8, 0.0)


def measured_capture(truth: Scene, count: int, normal: tuple[float, float, float] = UP) -> Any:
    """Photographs of an object, and the irradiance on a card from the sum over texels in float64."""
    capture = photographs(truth, around(count))
    assert truth.environment is not None
    value = irradiance_by_sum(truth.environment.radiance.double().numpy(), np.array(normal))
    names = [view.name for view in capture.views]
    return replace(capture, irradiance=MeasuredIrradiance(normal, dict.fromkeys(names, tuple(value.tolist()))))


def irradiance_by_sum(radiance: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Written out texel by texel: cosine × sin θ · Δθ · Δφ."""
    height, width, _ = radiance.shape
    total = np.zeros(3)
    for row in range(height):
        for column in range(width):
            theta, phi = np.pi * (row + 0.5) / height, 2 * np.pi * (0.5 - (column + 0.5) / width)
            way = np.array([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)])
            solid = (2 * np.pi / width) * (np.cos(np.pi * row / height) - np.cos(np.pi * (row + 1) / height))
            total += max(way @ normal, 0) * solid * radiance[row, column]
    return total


@pytest.mark.parametrize("normal", [UP, TILTED])
def test_irradiance_of_a_smooth_light_is_that_of_its_harmonics(normal: tuple[float, float, float]) -> None:
    """Light of bands 0 to 2 alone: Ramamoorthi and Hanrahan's formula is exact for it."""
    from hir_exporters.conventions import latlong_directions

    coefficients = np.random.default_rng(3).uniform(0.05, 0.2, (9, 3))
    coefficients[0] = 3
    directions = latlong_directions(64, 128)
    radiance = np.einsum("hwk,kc->hwc", harmonic_basis(directions), coefficients)
    expected = harmonic_basis(np.array(normal)[None, None])[0, 0] @ irradiance_harmonics(radiance)
    capture = measured_capture(Scene(ball(), make_material(BROWN), lamps()), 2, normal)
    light = EnvironmentMap(torch.from_numpy(radiance.astype(np.float32)))
    found = card_irradiance(light, capture)
    assert found.shape == (2, 3)
    np.testing.assert_allclose(found[0].numpy(), expected, rtol=2e-3)


def test_a_light_on_the_camera_brings_the_card_another_irradiance_in_each_view() -> None:
    """The normal in the axes of each camera, by the rotation of each."""
    capture = measured_capture(Scene(ball(), make_material(BROWN), lamps()), 3)
    radiance = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0))
    upright = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    found = card_irradiance(EnvironmentMap(radiance, upright, "camera"), capture)
    for row, camera in zip(found, capture.cameras, strict=True):
        normal = upright.double().numpy().T @ camera.world_to_camera[:3, :3] @ np.array(UP)
        np.testing.assert_allclose(row.numpy(), irradiance_by_sum(radiance.double().numpy(), normal), rtol=1e-5)


@pytest.mark.parametrize("frame", ["world", "camera"])
def test_a_light_that_brings_the_card_nothing_has_finite_factors(frame: Any) -> None:
    capture = measured_capture(Scene(ball(), make_material(BROWN), lamps()), 2)
    found = measured_over_found(EnvironmentMap(torch.zeros(4, 8, 3), None, frame), capture)
    assert found.tolist() == [1, 1, 1]


def test_a_card_in_photographs_that_are_not_used_counts_as_none() -> None:
    truth = Scene(ball(), make_material(BROWN), lamps())
    capture = measured_capture(truth, 3)
    assert capture.irradiance is not None
    values = {"elsewhere": (1.0, 1.0, 1.0)}
    capture = replace(capture, irradiance=replace(capture.irradiance, values=values))
    assert measured_over_found(lamps(), capture).tolist() == [1, 1, 1]
    assert light_scale_report(truth, capture, light_is_known=False) == ASSUMED


def test_light_that_contradicts_the_card_is_said() -> None:
    agreeing = LightScaleReport("card", "", 3, 0.01, (1.05, 1.0, 0.97))
    assert disagreement_warning(agreeing) is None and disagreement_warning(ASSUMED) is None
    found = disagreement_warning(replace(agreeing, found_over_measured=(1.3, 1.0, 1.0)))
    assert found is not None and "1.30, 1.00, 1.00 times the measured irradiance" in found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "brightness", "albedo"), [("diffuse", 2.0, 0.4), ("dielectric", 0.5, 1.6), ("metal", 2.0, 0.4)]
)
def test_albedo_and_light_have_the_scale_of_the_card(
    kind: str, brightness: float, albedo: float, tmp_path: Path
) -> None:
    """A bright object in dark light or the opposite; only the card tells them apart."""
    light = replace(lamps(), radiance=lamps().radiance * brightness)
    color = torch.tensor(BROWN) * albedo
    material = {
        "diffuse": make_material(color),
        "dielectric": make_material(color, 0.04, 0.2, "dielectric"),
        "metal": Material.metallic(color, torch.ones(1), torch.full((1,), 0.2)),
    }[kind]
    truth = Scene(ball(), material, light)
    scene, report = fitted(truth.mesh, measured_capture(truth, 24), tmp_path)
    assert scene.environment is not None and scene.material is not None and report.light_scale.source == "card"
    expected, found = (irradiance_by_sum(e.radiance.double().numpy(), np.array(UP)) for e in (light, scene.environment))
    np.testing.assert_allclose(found, expected, rtol=0.03)
    assert report.explanation is not None and report.explanation.chosen.startswith(kind), report.explanation
    fitted_color = scene.material.base_color if kind == "metal" else scene.material.diffuse_albedo
    # without a card the colours are wrong by a factor of 3 in dark light
    found_color = fitted_color.flatten(0, -2).median(dim=0).values.numpy()
    np.testing.assert_allclose(found_color, color.numpy(), rtol=0.07, atol=0.01)
