"""The irradiance that photographs of the grey card show, where it is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hir_core.capture import Capture, View
from hir_core.capture.pixels import Pixels
from hir_core.errors import CaptureError, ConfigError
from hir_plugins.initializers.markers.fiducial_markers import FiducialMarkers
from hir_plugins.initializers.markers.grey_card import DICTIONARY, GreyCard
from hir_plugins.initializers.markers.marker_views import PAPER, marker_capture
from hir_plugins.initializers.options import FiducialMarkersOptions
from tests.hir_plugins.initializers.test_fiducial_markers import cameras

SIDE = 0.4
LIGHT = np.array([1.2, 0.9, 0.6])
"""Colour of white paper of reflectance 1 under the light, so the irradiance is π times this."""


def stored(color: np.ndarray, mask: np.ndarray | None, saturated: np.ndarray) -> Callable[[], Pixels]:
    pixels = Pixels(color.astype(np.float32), mask, saturated)
    return lambda: pixels


def photographs(exposures: Any = 1.0, noise: float = 0.0) -> Capture:
    """The card under a coloured light, clipped at 1; `exposures`: of each photograph."""
    capture = marker_capture(Path("made"), cameras(), GreyCard(SIDE))
    factors = np.broadcast_to(exposures, len(capture.views))
    random = np.random.default_rng(0)

    def exposed(color: np.ndarray, factor: float) -> Callable[[], Pixels]:
        shown = color * (LIGHT * factor).astype(np.float32)
        shown = shown + noise * random.standard_normal(shown.shape).astype(np.float32)
        return stored(shown.clip(0, 1), None, (shown >= 1).any(axis=2))

    views = (
        replace(view, read=exposed(view.pixels().color_linear, factor))
        for view, factor in zip(capture.views, factors, strict=True)
    )
    return replace(capture, views=tuple(views))


def solved(capture: Capture, folder: Path, **options: Any) -> tuple[Capture, dict[str, Any]]:
    """By the dictionary of the card; to find it takes most of the time, and has tests of its own."""
    given = {"side": 0.05, "paper_reflectance": PAPER, "dictionary": DICTIONARY} | options
    initializer = FiducialMarkers(FiducialMarkersOptions(**given))
    found = initializer.initialize(capture, None, folder)[0]
    return found, dict(initializer.report())


@pytest.fixture(scope="module")
def plain() -> Capture:
    return photographs()


def test_the_card_shows_the_irradiance_and_metres(plain: Capture, tmp_path: Path) -> None:
    found, report = solved(plain, tmp_path)
    assert found.irradiance is not None and len(found.irradiance.values) >= 8
    np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT, rtol=0.005)
    np.testing.assert_allclose(found.irradiance.normal, [0, 1, 0], atol=0.01)
    assert report["card"]["photographs"] == len(found.irradiance.values) and report["card"]["relative_deviation"] < 0.01
    scale = np.linalg.norm(found.world_from_source[0, :3])
    assert scale == pytest.approx(0.05 / SIDE, rel=0.005)


def test_another_paper_has_another_irradiance(plain: Capture, tmp_path: Path) -> None:
    found, _ = solved(plain, tmp_path, paper_reflectance=PAPER / 2)
    assert found.irradiance is not None
    np.testing.assert_allclose(found.irradiance.mean, 2 * np.pi * LIGHT, rtol=0.005)


def test_photographs_whose_paper_is_clipped_count_by_the_greys(tmp_path: Path) -> None:
    """Red paper is clipped at an exposure of 1.3; the greys have 0.75 and 0.5 of it."""
    exposures = np.where(np.arange(12) % 2, 1.6, 1.0)
    found, _ = solved(photographs(exposures), tmp_path)
    assert found.irradiance is not None
    values = found.irradiance.values
    clipped = [name for i, name in enumerate(v.name for v in found.views) if exposures[i] > 1 and name in values]
    assert clipped, "photographs with clipped paper are used"
    for i, view in enumerate(found.views):
        if view.name in values:
            np.testing.assert_allclose(values[view.name], np.pi * LIGHT * exposures[i], rtol=0.01)


def test_known_exposures_are_divided_out(tmp_path: Path) -> None:
    exposures = np.geomspace(0.4, 1.0, 12)
    capture = photographs(exposures)
    views = tuple(replace(v, exposure=float(e)) for v, e in zip(capture.views, exposures, strict=True))
    found, report = solved(replace(capture, views=views), tmp_path)
    assert found.irradiance is not None
    np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT, rtol=0.005)
    assert report["card"]["relative_deviation"] < 0.01


def test_what_stands_on_the_card_or_shades_it_is_left_out(plain: Capture, tmp_path: Path) -> None:
    """A dark object hides a part of the upper row in every photograph, once with a mask and once without."""
    for masked in (True, False):
        views = []
        for view in plain.views:
            pixels, camera = view.pixels(), view.camera
            assert camera is not None
            at = camera.project(np.array([[-0.3, 0.0, -0.25]]))[0][0]
            y, x = np.mgrid[: camera.height, : camera.width] + 0.5
            near = (x - at[0]) ** 2 + (y - at[1]) ** 2 < 25**2
            color = np.where(near[..., None], 0.05, pixels.color_linear).astype(np.float32)
            mask = near.astype(np.float32) if masked else None
            views.append(replace(view, read=stored(color, mask, pixels.saturated)))
        found, _ = solved(replace(plain, views=tuple(views)), tmp_path)
        assert found.irradiance is not None
        np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT, rtol=0.01)


@pytest.mark.slow
def test_noise_is_averaged(tmp_path: Path) -> None:
    found, _ = solved(photographs(0.5, noise=0.03), tmp_path)
    assert found.irradiance is not None
    np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT * 0.5, rtol=0.02)


def test_a_card_that_is_clipped_everywhere_is_said(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="the paper of the card is clipped, hidden or too small in all photographs"):
        found, report = solved(photographs(4.0), tmp_path)
    assert found.irradiance is None and "card" not in report


def test_settings_of_the_paper(plain: Capture, tmp_path: Path) -> None:
    found, report = solved(plain, tmp_path, paper_reflectance=0.0)
    assert found.irradiance is None and "card" not in report
    for wrong in (-0.1, 0.01, 1.5, float("nan")):
        with pytest.raises(ConfigError, match=r"paper_reflectance is .*give 0\.02 to 1, such as 0\.85"):
            solved(plain, tmp_path, paper_reflectance=wrong)


def test_a_curved_card_gives_no_irradiance(plain: Capture) -> None:
    """Markers of another layout with the numbers of the card."""
    from hir_plugins.initializers.markers.card_photographs import measured_irradiance
    from hir_plugins.initializers.markers.grey_card import MARKERS, corners_on_card

    flat = {n: np.column_stack([corners_on_card(n) * SIDE, np.zeros(4)]) for n in MARKERS}
    curved = {n: c + np.array([0, 0, 0.3 * SIDE * (i == 0)]) for i, (n, c) in enumerate(flat.items())}
    assert measured_irradiance(plain, curved, PAPER) is None
    assert measured_irradiance(plain, {n: flat[n] for n in MARKERS[:2]}, PAPER) is None


def test_of_several_takes_the_first_one_shows_the_card(plain: Capture, tmp_path: Path) -> None:
    """The first take shows the card where it lay; in the second the object, and so the cameras, moved against it."""
    views = list(plain.views)
    for i, view in enumerate(views):
        camera = view.camera
        assert camera is not None
        turned = replace(camera, world_to_camera=camera.world_to_camera @ np.diag([1.0, -1, -1, 1]))
        views[i] = replace(view, take="standing") if i % 2 else replace(view, take="upside_down", camera=turned)
    views.sort(key=lambda view: view.take)
    found, report = solved(replace(plain, views=tuple(views)), tmp_path)
    assert found.irradiance is not None and "card" in report
    assert set(found.irradiance.values) <= {view.name for view in views if view.take == "standing"}
    np.testing.assert_allclose(found.irradiance.normal, (0, 1, 0), atol=0.02)
    scale = np.linalg.norm(found.world_from_source[0, :3])
    assert scale == pytest.approx(0.05 / SIDE, rel=0.005)
    np.testing.assert_allclose(found.world_from_source[:3, :3] / scale, np.eye(3), atol=0.02)
    views.reverse()
    hidden = [replace(view, read=black(view)) if view.take == "upside_down" else view for view in views]
    with pytest.raises(CaptureError, match="in the photographs of the first take, upside_down, no marker"):
        solved(replace(plain, views=tuple(hidden)), tmp_path)


def black(view: View) -> Callable[[], Pixels]:
    shape = view.pixels().color_linear.shape
    return stored(np.zeros(shape), None, np.zeros(shape[:2], bool))
