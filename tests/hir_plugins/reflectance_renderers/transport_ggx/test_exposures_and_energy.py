"""Fits of photographs with different exposures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Capture, Pixels, View
from hir_core.capture.relative_exposures import without_reflections
from hir_core.metrics import nearest_exposure
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.transport_ggx.fit.exposures import own_exposures
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelColors
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_exposures import initial_exposures
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.scenes import icosphere, looking_at

SIZE = 32
FACTORS = np.array([1.0, 1.3, 0.8, 1.1, 0.7, 1.25])[:, None] * [
    [1.0, 1.0, 1.0],
    [1.1, 1.0, 0.9],
    [0.9, 1.0, 1.0],
    [1.0, 1.0, 1.1],
    [1.2, 1.0, 0.9],
    [1.0, 1.0, 0.8],
]
"""Of six photographs: brightness, times red, green and blue of the white balance."""
FITTED = ModelSpec(exposures="fitted")


def photographs(factors: np.ndarray) -> tuple[Capture, Scene]:
    """A grey ball under a smooth light from six sides; each photograph is multiplied by its factors."""
    light = 0.5 + 0.4 * texel_directions(16, 32)[:, 1:2]
    sky = EnvironmentMap((light * torch.tensor([0.9, 0.8, 0.7])).reshape(16, 32, 3).float())
    grey = Material("paper", torch.full((3,), 0.5), torch.zeros(3), torch.ones(1))
    scene = Scene(icosphere(3), grey, sky)
    eyes = [(4 * np.sin(a), 1.0, 4 * np.cos(a)) for a in np.linspace(0, 2 * np.pi, 6, endpoint=False)]
    nothing = np.zeros((SIZE, SIZE), bool)
    empty = Pixels(np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), nothing)
    cameras = [looking_at(eye, SIZE, SIZE) for eye in eyes]
    blank = Capture(Path("made"), tuple(View(str(i), c, lambda: empty) for i, c in enumerate(cameras)))
    prepared = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800)).prepare(scene, blank)
    grid = torch.tensor([(v, x, y) for v in range(6) for y in range(SIZE) for x in range(SIZE)])
    shown = prepared.radiance(grey, sky, grid).reshape(6, SIZE, SIZE, 3).numpy()
    views = []
    for i, (camera, factor) in enumerate(zip(cameras, factors, strict=True)):
        color = (shown[i] * factor).astype(np.float32)
        pixels = Pixels(color, (color.sum(axis=2) > 0).astype(np.float32), nothing)
        views.append(View(str(i), camera, lambda pixels=pixels: pixels))  # type: ignore[misc]
    start = replace(scene, environment=EnvironmentMap(torch.full((16, 32, 3), 0.5)))
    return Capture(Path("made"), tuple(views)), start


def first_exposures(capture: Capture, scene: Scene, views: range = range(6)) -> np.ndarray:
    """Factors before any fit."""
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800)).prepare(scene, capture)
    transport, pixels = solver._transport, solver._pixels.of(views)  # type: ignore[attr-defined]
    eyes = np.stack([camera.center for camera in capture.cameras]).astype(np.float64)
    return initial_exposures(transport.surface, pixels, eyes).exp().numpy()


def test_first_exposures_of_a_matt_ball_are_nearly_exact() -> None:
    found = first_exposures(*photographs(FACTORS))
    np.testing.assert_allclose(found, FACTORS / np.exp(np.log(FACTORS).mean(axis=0)), rtol=0.01)


def test_reflections_that_change_smoothly_are_no_exposures() -> None:
    """Brightness that depends on the direction of the camera alone; then with exposures beside it."""
    rng = np.random.default_rng(3)
    toward = rng.normal(size=(60, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    smooth = 0.5 * np.stack([toward[:, 0] * toward[:, 1], toward[:, 1], toward[:, 2] ** 2], axis=1)
    assert without_reflections(smooth, toward).std() < 0.1 * smooth.std()
    exposures = rng.normal(0, 0.3, (60, 3))
    exposures -= exposures.mean(axis=0)
    np.testing.assert_allclose(without_reflections(exposures, toward), exposures, atol=0.2)
    both = without_reflections(smooth + exposures, toward) - exposures
    assert both.std() < 0.75 * smooth.std()


@pytest.mark.parametrize("views", [1, 2, 3])
def test_few_views_have_finite_first_exposures(views: int) -> None:
    toward = np.eye(3)[:views]
    for common in (np.zeros((views, 3)), np.log(FACTORS[:views])):
        found = without_reflections(common, toward)
        assert found.shape == (views, 3) and np.isfinite(found).all()


def test_highlights_count_little_in_first_exposures() -> None:
    """One twentieth of the pixels, others in each photograph, are five times as bright."""
    capture, scene = photographs(FACTORS)
    rng = np.random.default_rng(1)

    def brighter(view: View) -> View:
        pixels = view.read()
        factor = np.where(rng.uniform(size=(SIZE, SIZE, 1)) < 0.05, 5, 1).astype(np.float32)
        changed = replace(pixels, color_linear=pixels.color_linear * factor)
        return replace(view, read=lambda: changed)

    found = first_exposures(replace(capture, views=tuple(map(brighter, capture.views))), scene)
    np.testing.assert_allclose(found, FACTORS / np.exp(np.log(FACTORS).mean(axis=0)), rtol=0.02)


def test_own_exposures_are_those_of_the_evaluation_for_each_view() -> None:
    generator = torch.Generator().manual_seed(4)
    view = torch.arange(300) % 3  # the fourth view has no pixels
    color, radiance = torch.rand(300, 3, generator=generator), torch.rand(300, 3, generator=generator)
    saturated = (color > 0.9).any(dim=1, keepdim=True).expand(-1, 3)
    pixels = PixelColors(linear_to_srgb(color), saturated, view, torch.ones(300))
    found = own_exposures(pixels, radiance, 4).numpy()
    for i in range(3):
        rows = (view == i) & ~saturated[:, 0]
        np.testing.assert_allclose(found[i], nearest_exposure(radiance[rows].numpy(), color[rows].numpy()), rtol=1e-4)
    assert found[3].tolist() == [1, 1, 1]


def test_a_view_without_pixels_has_the_mean_exposure() -> None:
    found = first_exposures(*photographs(FACTORS), range(5))
    assert np.isfinite(found).all() and (found[5] == 1).all()


def test_a_fit_of_more_views_keeps_what_an_earlier_one_found() -> None:
    capture, scene = photographs(FACTORS)
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800, steps=150)).prepare(scene, capture)
    fit = solver.fit(FITTED, None, range(5), 1.0, lambda _: None)  # type: ignore[attr-defined]
    # a short fit does not change exposures; the last view has one that suits the earlier fit
    later = solver.fit(FITTED, fit, range(6), 0.02, lambda _: None)  # type: ignore[attr-defined]
    ratio = later.parameters.exposure / fit.parameters.exposure
    np.testing.assert_allclose(ratio[:5], ratio[:1].expand(5, 3), rtol=1e-5)
    true = torch.from_numpy(FACTORS[5] / FACTORS[:5].prod(axis=0) ** 0.2)
    found = later.parameters.exposure[5] / later.parameters.exposure[:5].prod(dim=0) ** 0.2
    np.testing.assert_allclose(found, true, rtol=0.1)
    # the light takes the common factor: predictions stay
    assert solver.errors(later, range(5)).mean() < 1e-4  # type: ignore[attr-defined]


def test_a_fit_with_equal_exposures_continues_with_those_that_its_prediction_shows() -> None:
    capture, scene = photographs(FACTORS)
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800, steps=150)).prepare(scene, capture)
    equal = solver.fit(ModelSpec(), None, range(6), 1.0, lambda _: None)  # type: ignore[attr-defined]
    true = np.log(FACTORS) - np.log(FACTORS).mean(axis=0)
    # albedos that only two or three photographs show have absorbed a part, which further steps give back
    for effort, error in ((0.02, 0.7), (1.0, 0.2)):
        later = solver.fit(FITTED, equal, range(6), effort, lambda _: None)  # type: ignore[attr-defined]
        assert (later.parameters.exposure.log().numpy() - true).std() < error * true.std()


def test_recorded_exposures_are_used_as_they_are() -> None:
    capture, scene = photographs(FACTORS[:, 1:2] * np.ones(3))
    recorded = (replace(v, recorded_exposure=0.02 * f) for v, f in zip(capture.views, FACTORS[:, 1], strict=True))
    capture = replace(capture, views=tuple(recorded))
    solver = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800, steps=20)).prepare(scene, capture)
    fit = solver.fit(ModelSpec(exposures="recorded"), None, range(6), 1.0, lambda _: None)  # type: ignore[attr-defined]
    true = FACTORS[:, 1:2] / np.exp(np.log(FACTORS[:, 1]).mean()) * np.ones(3)
    np.testing.assert_allclose(fit.parameters.exposure.numpy(), true, rtol=1e-5)


@pytest.mark.slow
def test_drifting_exposures_are_found_and_cost_nothing() -> None:
    capture, scene = photographs(FACTORS)
    errors = {}
    for gain in (False, True):
        options = TransportGGXOptions(vertices=0, cache_cells=800, steps=150)
        solver = TransportGGX(options).prepare(scene, capture)
        fit = solver.fit(FITTED if gain else ModelSpec(), None, range(6), 1.0, lambda _: None)  # type: ignore[attr-defined]
        errors[gain] = solver.errors(fit, range(6)).mean()  # type: ignore[attr-defined]
        if gain:
            found = fit.parameters.exposure.numpy()
            true = FACTORS / np.exp(np.log(FACTORS).mean(axis=0))
            np.testing.assert_allclose(found, true, rtol=0.03)
    assert errors[True] < 0.05 * errors[False]


def test_a_held_out_photograph_is_compared_at_its_own_exposure() -> None:
    capture, scene = photographs(FACTORS)
    options = TransportGGXOptions(vertices=0, cache_cells=800, steps=150)
    solver = TransportGGX(options).prepare(scene, capture)
    fit = solver.fit(FITTED, None, range(5), 1.0, lambda _: None)  # type: ignore[attr-defined]
    found = -10 * np.log10(solver.errors(fit, [5])[0])  # type: ignore[attr-defined]
    as_others = replace(fit, spec=ModelSpec(), parameters=replace(fit.parameters, log_exposure=None))
    # the remaining error is at the rim, which no other photograph shows
    assert found > 28 and found > 6 - 10 * np.log10(solver.errors(as_others, [5])[0])  # type: ignore[attr-defined]
