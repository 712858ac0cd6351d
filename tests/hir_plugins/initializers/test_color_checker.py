"""The irradiance that a ColorChecker shows, where it is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear

from hir_core.capture import Capture, View
from hir_core.capture.pixels import Pixels
from hir_core.errors import CaptureError, ConfigError
from hir_plugins.initializers.color_chart import chart_detection
from hir_plugins.initializers.color_chart.chart_detection import (
    GREYS,
    GRID_POSITIONS,
    can_detect,
    find_chart,
    is_cut_out,
    reference_colors,
    shows_chart,
)
from hir_plugins.initializers.color_chart.chart_geometry import chart_in_space, chart_normal
from hir_plugins.initializers.color_chart.chart_views import GAP, ColorCheckerSheet
from hir_plugins.initializers.color_chart.color_checker import ColorChecker, response_exponent
from hir_plugins.initializers.markers.grey_card import GreyCard
from hir_plugins.initializers.markers.marker_views import marker_capture
from hir_plugins.initializers.options import ColorCheckerOptions
from hir_plugins.initializers.plugin import hir_suggest_initializers
from tests.hir_plugins.initializers.test_fiducial_markers import cameras

if not can_detect():
    pytest.skip("OpenCV 4 has no detector of colour charts", allow_module_level=True)

LIGHT = np.array([0.85, 0.7, 0.5])
"""Colour of white of reflectance 1 under the light, so the irradiance is π times this."""


def stored(color: np.ndarray, mask: np.ndarray | None = None) -> Callable[[], Pixels]:
    pixels = Pixels(color.clip(0, 1).astype(np.float32), mask, (color >= 1).any(axis=2))
    return lambda: pixels


def changed(capture: Capture, change: Callable[[int, np.ndarray], np.ndarray]) -> Capture:
    """`change`: number and linear values of a photograph to its new linear values; clipped at 1."""
    views = (replace(v, read=stored(change(i, v.pixels().color_linear))) for i, v in enumerate(capture.views))
    return replace(capture, views=tuple(views))


@pytest.fixture(scope="module")
def unlit() -> Capture:
    return marker_capture(Path("made"), cameras(), ColorCheckerSheet(0.35))


@pytest.fixture(scope="module")
def plain(unlit: Capture) -> Capture:
    """Under a coloured light."""
    return changed(unlit, lambda _, color: color * LIGHT)


def solved(capture: Capture, folder: Path, **options: Any) -> tuple[Capture, dict[str, Any]]:
    initializer = ColorChecker(ColorCheckerOptions(**options))
    found, scene = initializer.initialize(capture, None, folder)
    assert scene is None
    return found, dict(initializer.report().get("color_checker", {}))  # type: ignore[call-overload]


def test_the_chart_shows_the_irradiance(plain: Capture, tmp_path: Path) -> None:
    found, report = solved(plain, tmp_path)
    assert found.irradiance is not None and len(found.irradiance.values) >= 5 and report["used"]
    np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT, rtol=0.01)
    np.testing.assert_allclose(found.irradiance.normal, [0, 1, 0], atol=0.05)
    assert report["photographs"] == len(found.irradiance.values) and report["relative_deviation"] < 0.01
    assert report["response_exponent"][0] == pytest.approx(1, abs=0.01)
    assert found.world_from_source is plain.world_from_source, "it gives no metres"
    faded, _ = solved(plain, tmp_path, reflectance_factor=0.8)
    assert faded.irradiance is not None
    np.testing.assert_allclose(faded.irradiance.mean, np.array(found.irradiance.mean) / 0.8, rtol=1e-6)


def test_the_normal_is_that_of_a_chart_that_stands(tmp_path: Path) -> None:
    angle = np.radians(40)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    found, _ = solved(marker_capture(Path("made"), cameras(), ColorCheckerSheet(0.35), turn=turn), tmp_path)
    assert found.irradiance is not None
    np.testing.assert_allclose(found.irradiance.normal, turn[:, 1], atol=0.05)


def test_noise_and_clipped_white_are_no_obstacle(unlit: Capture, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    bright = changed(unlit, lambda _, color: color * 1.3 + 0.01 * random.standard_normal(color.shape))
    found, _ = solved(bright, tmp_path)
    assert found.irradiance is not None
    np.testing.assert_allclose(found.irradiance.mean, np.pi * 1.3 * np.ones(3), rtol=0.02)


def test_known_exposures_are_divided_out(unlit: Capture, tmp_path: Path) -> None:
    exposures = np.geomspace(0.4, 1.0, 12)
    shown = changed(unlit, lambda i, color: color * LIGHT * exposures[i])
    views = tuple(replace(v, exposure=float(e)) for v, e in zip(shown.views, exposures, strict=True))
    found, report = solved(replace(shown, views=views), tmp_path)
    assert found.irradiance is not None
    np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT, rtol=0.01)
    assert report["relative_deviation"] < 0.01


@pytest.mark.parametrize("gamma", [0.8, pytest.param(1.3, marks=pytest.mark.slow)])
def test_another_response_is_said(plain: Capture, tmp_path: Path, gamma: float) -> None:
    """A phone's contrast curve changes the encoded values; the exponent is nearly that of the linear ones."""
    curved = changed(plain, lambda _, color: srgb_to_linear(linear_to_srgb(color) ** gamma))
    with pytest.warns(UserWarning, match="the camera's response is not that of sRGB"):
        _, report = solved(curved, tmp_path)
    assert report["response_exponent"][0] == pytest.approx(gamma, abs=0.1)


def test_the_exponent_of_a_chart_that_is_shaded_on_one_side() -> None:
    reference = reference_colors()
    greys = np.repeat(reference.mean(axis=1, keepdims=True), 3, axis=1)
    shade = np.exp(0.3 - 0.1 * GRID_POSITIONS[:, :1] + 0.05 * GRID_POSITIONS[:, 1:])
    hidden = np.full_like(reference, np.nan)
    for exponent in (1.0, 1.25):
        colors = np.stack([shade * greys**exponent, 0.4 * greys**exponent, hidden])
        found = response_exponent(colors)
        assert found is not None and found[0] == pytest.approx(exponent, abs=0.05)
    assert response_exponent(np.stack([hidden, hidden])) is None


def test_the_object_may_hide_a_part_of_the_chart(plain: Capture, tmp_path: Path) -> None:
    """A ball of many colours on three columns of it."""
    random = np.random.default_rng(0)
    views = []
    for view in plain.views:
        pixels, camera = view.pixels(), view.camera
        assert camera is not None
        at = camera.project(np.array([[-1.1, 0.3, 0.0]]))[0][0]
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        near = (x - at[0]) ** 2 + (y - at[1]) ** 2 < 90**2
        color = np.where(near[..., None], random.random(pixels.color_linear.shape), pixels.color_linear)
        views.append(replace(view, read=stored(color)))
    found, report = solved(replace(plain, views=tuple(views)), tmp_path)
    assert found.irradiance is not None and report["photographs"] >= 3
    np.testing.assert_allclose(found.irradiance.mean, np.pi * LIGHT, rtol=0.01)
    np.testing.assert_allclose(found.irradiance.normal, [0, 1, 0], atol=0.03)


def test_a_card_is_kept(plain: Capture, tmp_path: Path) -> None:
    found, _ = solved(plain, tmp_path)
    again, report = solved(found, tmp_path)
    assert again.irradiance is found.irradiance and not report["used"]


def test_a_chart_that_moves_is_a_warning(plain: Capture, tmp_path: Path) -> None:
    """On a turntable that the chart does not stand on."""
    turned = cameras()[3:] + cameras()[:3]
    views = tuple(replace(v, camera=camera) for v, camera in zip(plain.views, turned, strict=True))
    with pytest.warns(UserWarning, match="must not move relative to the object"):
        found, report = solved(replace(plain, views=views), tmp_path)
    assert found.irradiance is None and not report


def test_one_wrong_camera_is_left_out(plain: Capture, tmp_path: Path) -> None:
    charts = {i: chart for i, view in enumerate(plain.views) if (chart := find_chart(view)) is not None}
    wrong = dict(enumerate(plain.cameras))
    first = next(iter(charts))
    wrong[first] = plain.cameras[(first + 4) % len(plain.cameras)]
    pose = chart_in_space(charts, [wrong[i] for i in range(len(wrong))])
    assert pose is not None
    np.testing.assert_allclose(chart_normal(pose), [0, 1, 0], atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(pose[:, :2], axis=0), 0.35 * (1 + GAP), rtol=0.01)


@pytest.mark.slow
def test_other_things_are_no_chart(plain: Capture, tmp_path: Path) -> None:
    card = marker_capture(Path("made"), cameras(), GreyCard(0.4))
    swapped = changed(plain, lambda _, color: color[..., [2, 0, 1]])
    for capture in (card, swapped):
        assert not any(find_chart(view) for view in capture.views)
        with pytest.raises(CaptureError, match="no photograph shows a ColorChecker with 24 patches"):
            solved(capture, tmp_path)
    dark = changed(plain, lambda _, color: 0 * color)
    assert find_chart(dark.views[0]) is None


def test_clipped_greys_say_nothing(unlit: Capture, tmp_path: Path) -> None:
    """The detector still finds the chart; all but the darkest grey are clipped, and gloss lies on that."""
    views = []
    for view in unlit.views:
        chart, pixels = find_chart(view), view.pixels()
        color = pixels.color_linear.copy()
        if chart is not None:
            for patch in range(GREYS.start, GREYS.stop):
                x, y = chart.grid(patch).mean(axis=0).astype(int)
                color[y : y + 2, x : x + 2] = 1.0
        views.append(replace(view, read=stored(color)))
    with pytest.warns(UserWarning, match="clipped, hidden or uneven in all photographs"):
        found, report = solved(replace(unlit, views=tuple(views)), tmp_path)
    assert found.irradiance is None and not report


def test_it_is_suggested_where_photographs_show_it(plain: Capture) -> None:
    assert shows_chart(plain.views, 6) and hir_suggest_initializers(plain) == [
        "colmap",
        "color_checker",
        "visual_hull",
    ]
    blank = changed(plain, lambda _, color: np.full_like(color, 0.2))
    assert "color_checker" not in (hir_suggest_initializers(blank) or [])


def test_all_photographs_are_searched_where_one_of_a_few_shows_a_chart(
    plain: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[str] = []

    def found_in(names: set[str]) -> bool:
        def found(view: View) -> View | None:
            searched.append(view.name)
            return view if view.name in names else None

        searched.clear()
        monkeypatch.setattr(chart_detection, "find_chart", found)
        return shows_chart(plain.views, 3)

    assert not found_in(set()) and searched == ["00", "06", "11"]
    assert found_in({"00", "11"}) and len(searched) == 3
    assert found_in({"06", "10"}) and searched[3:] == ["01", "02", "03", "04", "05", "07", "08", "09", "10"]
    assert not found_in({"06"}) and len(searched) == 12


def test_photographs_without_background_are_not_searched(plain: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    def with_mask(view: View, background: float) -> Pixels:
        pixels = view.pixels()
        mask = np.zeros(pixels.saturated.shape, np.float32)
        mask[200:280, 200:280] = 1
        return replace(
            pixels, mask=mask, color_linear=np.where(mask[..., None] > 0, 0.3, background * pixels.color_linear)
        )

    cut, whole = (with_mask(plain.views[0], background) for background in (0.0, 1.0))
    assert is_cut_out(cut) and not is_cut_out(whole) and not is_cut_out(plain.views[0].pixels())
    monkeypatch.setattr(chart_detection, "find_chart", lambda view: pytest.fail("searched"))
    views = tuple(replace(view, read=lambda cut=cut: cut) for view in plain.views)
    assert "color_checker" not in (hir_suggest_initializers(replace(plain, views=views)) or [])


def test_an_opencv_without_the_detector_is_said(
    plain: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(chart_detection.cv2, "mcc")
    assert "color_checker" not in (hir_suggest_initializers(plain) or [])
    with pytest.raises(ConfigError, match="install version 5 or newer"):
        solved(plain, tmp_path)
