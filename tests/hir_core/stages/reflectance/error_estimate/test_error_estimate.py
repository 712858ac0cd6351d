"""Errors of maps on a made ball: photographs that contradict each other, what none shows, and what is stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hir_exporters.conventions import latlong_directions
from torch import Tensor

from hir_core.capture import Capture, Pixels, View
from hir_core.errors import InputError
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.plugins.manager import PluginManager
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.map_error_store import FILE, load_map_errors, save_map_errors
from hir_core.scene.map_errors import OBSERVED, OUTSIDE, UNDER_OBSERVED, MapErrors
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.atlas import unwrap_mesh
from hir_core.stages.reflectance.error_estimate.error_estimate import (
    HUBER_SRGB,
    MAX_PIXELS,
    MIN_VIEWS,
    PRIOR_WIDTHS,
    estimated_map_errors,
)
from hir_core.stages.reflectance.error_estimate.pixel_derivatives import STEPS, _changed, map_values, pixel_derivatives
from tests.fixtures.made_captures import around
from tests.fixtures.scenes import icosphere, looking_at

EXAMPLE = Path(__file__).parents[5] / "examples" / "gallery" / "lambert_sh.py"
PLUGINS = PluginManager.discover((str(EXAMPLE),))
SIZE, TEXELS, VIEWS = 32, 32, 12
ALBEDO = 0.4


def ball(albedo: Tensor) -> Scene:
    mesh, _ = unwrap_mesh(icosphere(2), TEXELS)
    directions = torch.from_numpy(latlong_directions(8, 16)).float()
    light = EnvironmentMap((0.8 + 0.4 * directions[..., 1:2]).expand(-1, -1, 3).contiguous())
    return Scene(mesh, Material("paper", albedo, torch.zeros(3), torch.ones(1)), light)


def photographed(scene_of: Callable[[int], Scene], eyes: Any = None) -> Capture:
    renderer = PLUGINS.create("reflectance_renderer", "lambert_sh")
    views = []
    for i, eye in enumerate(around(VIEWS) if eyes is None else eyes):
        camera = looking_at(eye, SIZE, SIZE)
        image = renderer.render(scene_of(i), camera).numpy().astype(np.float32)
        pixels = Pixels(image[..., :3], image[..., 3], np.zeros((SIZE, SIZE), bool))
        views.append(View(str(i), camera, lambda p=pixels: p))  # type: ignore[misc]
    return Capture(Path("made"), tuple(views))


def errors_of(scene: Scene, capture: Capture) -> MapErrors:
    prepared = PLUGINS.create("reflectance_renderer", "lambert_sh").prepare(scene, capture, 1)
    found = estimated_map_errors(scene, prepared, capture, 1, 0)
    assert found is not None
    return found


def grey() -> Tensor:
    return torch.full((TEXELS, TEXELS, 3), ALBEDO)


def test_photographs_that_agree_with_the_fit_leave_no_error() -> None:
    scene = ball(grey())
    found = errors_of(scene, photographed(lambda view: scene))
    surface = found.condition != OUTSIDE
    seen = surface & (found.condition != UNDER_OBSERVED)
    assert seen.sum() > 0.7 * surface.sum()
    assert np.nanmax(found.base_color[seen]) < 0.01
    assert np.isnan(found.base_color[~surface]).all() and np.isfinite(found.base_color[surface]).all()


def test_a_place_that_photographs_show_differently_is_uncertain() -> None:
    """Every second photograph shows the upper half of the texture brighter by a quarter."""
    brighter = grey()
    brighter[: TEXELS // 2] *= 1.25
    scene = ball(grey())
    found = errors_of(scene, photographed(lambda view: ball(brighter if view % 2 else grey())))
    error, rows = found.base_color.mean(axis=2), np.arange(len(found.condition))
    seen = (found.condition != OUTSIDE) & (found.condition != UNDER_OBSERVED)
    upper, lower = (np.median(error[half][seen[half]]) for half in (rows < len(rows) // 2 - 1, rows > len(rows) // 2))
    # albedos of 0.4 and 0.5: between the error of the mean of all photographs and that of one
    assert 0.05 / np.sqrt(VIEWS) < upper < 0.05
    assert lower < 0.2 * upper


def test_errors_are_those_of_estimates_without_each_photograph() -> None:
    """The definition, by loops over blocks and photographs, with equal weights because no residual is large."""
    brighter = grey()
    brighter[: TEXELS // 2] *= 1.1
    scene = ball(grey())
    capture = photographed(lambda view: ball(brighter if view % 2 else grey()))
    found = errors_of(scene, capture)
    prepared = PLUGINS.create("reflectance_renderer", "lambert_sh").prepare(scene, capture, 1)
    pixels = pixel_derivatives(scene, prepared, capture, 1, MAX_PIXELS // VIEWS, 0)
    side = len(found.condition)
    block = (pixels.uv.numpy() * side).astype(int)
    slope, residual = pixels.base_color[:, 0].double().numpy(), pixels.residual[:, 0].double().numpy()
    assert np.abs(residual).max() < HUBER_SRGB and bool(pixels.known.all())
    compared = 0
    for row, column in np.argwhere(found.condition == OBSERVED):
        here = (block == (column, row)).all(axis=1)
        views, weight = pixels.view.numpy()[here], slope[here] ** 2
        evidence = np.array([weight[views == view].sum() for view in range(VIEWS)])
        effective = evidence.sum() ** 2 / (evidence**2).sum()
        if effective < 2.5:
            continue
        product = slope[here] * residual[here]
        without = [-product[views != view].sum() / weight[views != view].sum() for view in range(VIEWS)]
        variance = (VIEWS - 1) / VIEWS * np.square(np.array(without) - np.mean(without)).sum()
        expected = np.sqrt(variance * effective / (effective - 1))
        assert found.base_color[row, column, 0] == pytest.approx(expected, rel=0.02, abs=1e-4)
        compared += 1
    assert compared > 10


def test_what_no_photograph_shows_has_the_width_of_the_prior() -> None:
    scene = ball(grey())
    above = [np.array([0.1 * np.cos(i), 3.0, 0.1 * np.sin(i)]) for i in range(VIEWS)]
    found = errors_of(scene, photographed(lambda view: scene, above))
    hidden = found.condition == UNDER_OBSERVED
    assert hidden.mean() > 0.2
    np.testing.assert_allclose(found.base_color[hidden], PRIOR_WIDTHS["base_color"], rtol=1e-5)
    shares = found.report()["shares"]
    assert shares["under_observed"] == pytest.approx(hidden.sum() / (found.condition != OUTSIDE).sum(), rel=1e-3)


def test_too_few_photographs_give_no_errors() -> None:
    scene = ball(grey())
    capture = photographed(lambda view: scene)
    few = replace(capture, views=capture.views[: MIN_VIEWS - 1])
    prepared = PLUGINS.create("reflectance_renderer", "lambert_sh").prepare(scene, few, 1)
    assert estimated_map_errors(scene, prepared, few, 1, 0) is None


class Formula(PreparedReflectance):
    """Radiance 2 ρd + 3 ρs + α of constants, everywhere."""

    def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
        total = 2 * material.diffuse_albedo + 3 * material.specular_albedo + material.roughness
        return total.expand(len(pixels), 3) * 0.1


@pytest.mark.parametrize("metallic", [False, True])
def test_derivatives_are_those_of_the_formula(metallic: bool) -> None:
    base, specular, alpha = torch.full((3,), 0.5), torch.full((3,), 0.05), torch.full((1,), 0.36)
    material = Material("dielectric", base, specular, alpha)
    if metallic:
        metalness = torch.full((TEXELS, TEXELS, 1), 0.25)
        material = Material.metallic(base.expand(TEXELS, TEXELS, 3), metalness, alpha, dielectric_f0=0.04)
    scene = replace(ball(grey()), material=material)
    capture = photographed(lambda view: ball(grey()))

    class Textured(PreparedReflectance):
        def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
            means = [
                each.reshape(-1, each.shape[-1]).mean(0) for each in (material.diffuse_albedo, material.specular_albedo)
            ]
            return Formula().radiance(Material("dielectric", *means, material.roughness), environment, pixels)

    found = pixel_derivatives(scene, Textured(), capture, 1, 20, 0)

    def encoded(diffuse: float, reflected: float, width: float) -> float:
        return float(linear_to_srgb(torch.tensor(0.1 * (2 * diffuse + 3 * reflected + width), dtype=torch.float64)))

    if metallic:
        # ρd = (1 − m)·base, ρs = (1 − m)·F0 + m·base
        def at(b: float = 0.5, m: float = 0.25, r: float = 0.6) -> float:
            return encoded((1 - m) * b, (1 - m) * 0.04 + m * b, r * r)

        expected = {"metalness": at(m=0.25 + STEPS["metalness"]), "roughness": at(r=0.6 + STEPS["roughness"])}
        base_color = at(b=0.5 + STEPS["base_color"])
    else:

        def at(b: float = 0.5, m: float = 0.05, r: float = 0.6) -> float:
            return encoded(b, m, r * r)

        expected = {"specular": at(m=0.05 + STEPS["specular"]), "roughness": at(r=0.6 + STEPS["roughness"])}
        base_color = at(b=0.5 + STEPS["base_color"])
    assert found.names == tuple(expected)
    for i, (name, value) in enumerate(expected.items()):
        np.testing.assert_allclose(found.others[:, i].numpy(), (value - at()) / STEPS[name], rtol=2e-3)
    np.testing.assert_allclose(found.base_color.numpy(), (base_color - at()) / STEPS["base_color"], rtol=2e-3)


@pytest.mark.parametrize("value", [0.0, 0.5, 0.99, 1.0])
def test_steps_stay_in_the_range_of_a_map(value: float) -> None:
    map_of = {channels: torch.full((2, 2, channels), value) for channels in (1, 3)}
    plain = Material("dielectric", map_of[3], map_of[3], map_of[1].square())
    metallic = Material.metallic(map_of[3], map_of[1], map_of[1].square())
    cases = [(plain, name) for name in ("base_color", "specular", "roughness")]
    cases += [(metallic, name) for name in ("base_color", "metalness", "roughness")]
    for material, name in cases:
        low, high = (map_values(_changed(material, name, end), name) for end in (0.0, 1.0))
        assert float(low.min()) >= 0 and float(high.max()) <= 1 + 1e-6
        np.testing.assert_allclose((high - low).numpy(), STEPS[name], rtol=1e-3)


def test_errors_are_stored_bit_for_bit_and_damage_is_named(tmp_path: Path) -> None:
    scene = ball(grey())
    found = replace(errors_of(scene, photographed(lambda view: scene)), constants={"roughness": 0.125})
    assert load_map_errors(tmp_path) is None
    save_map_errors(found, tmp_path)
    again = load_map_errors(tmp_path)
    assert again is not None and again.constants == found.constants and again.maps.keys() == found.maps.keys()
    np.testing.assert_array_equal(again.base_color, found.base_color)
    np.testing.assert_array_equal(again.condition, found.condition)
    (tmp_path / FILE).write_bytes(b"no archive")
    with pytest.raises(InputError, match=FILE):
        load_map_errors(tmp_path)
