"""Exposures that follow the recorded ones to another power than 1 show another response than that of sRGB."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Capture, View
from hir_core.scene import Scene
from hir_core.stages.reflectance.camera_response import MIN_PHOTOGRAPHS, camera_response, response_warning
from tests.fixtures.made_captures import around, ball, fitted, make_material, painted, photographs, sky

STOPS = np.linspace(-1.5, 1.5, 12)


def views(stops: np.ndarray = STOPS) -> list[View]:
    return [
        View(str(i), None, lambda: None, recorded_exposure=0.01 * float(2**s))  # type: ignore[arg-type,return-value]
        for i, s in enumerate(stops)
    ]


def factors(power: float, noise: float = 0.0, stops: np.ndarray = STOPS) -> dict[str, tuple[float, float, float]]:
    """Of a camera whose values are a power of the exposure; each channel with a white balance."""
    rng = np.random.default_rng(3)
    values = 2 ** (power * stops[:, None] + noise * rng.normal(size=(len(stops), 3)) + np.array([0.2, 0.0, -0.3]))
    return {str(i): (r, g, b) for i, (r, g, b) in enumerate(values.tolist())}


@pytest.mark.parametrize("power", [1.0, 0.75, 1.3])
def test_the_power_is_found(power: float) -> None:
    found = camera_response(factors(power), views())
    assert found is not None and found.exponent == pytest.approx(power, abs=1e-3) and found.standard_error < 1e-6
    assert found.recorded_stops == pytest.approx(3, abs=1e-3) and found.differs == (power != 1)
    warning = response_warning(found)
    assert (warning is None) == (power == 1) and (warning is None or f"power of {power:.2f}" in warning)


def test_noise_is_no_response() -> None:
    """A difference within the noise of the exposures, or below a tenth, is not reported."""
    for power, noise in ((1.0, 0.6), (0.93, 0.0)):
        found = camera_response(factors(power, noise), views())
        assert found is not None and not found.differs and response_warning(found) is None


def test_a_gain_of_the_photograph_counts() -> None:
    with_gain = [replace(view, exposure=float(2**s)) for view, s in zip(views(), STOPS, strict=True)]
    found = camera_response(factors(0.0), with_gain)
    assert found is not None and found.exponent == pytest.approx(1, abs=1e-3)


def test_the_brightness_of_a_take_is_no_response() -> None:
    """Fitted exposures have a mean of 1 in each take, whatever is recorded."""
    half = len(STOPS) // 2
    stops = np.concatenate([STOPS[::2], STOPS[::2] + 3])
    taken = [replace(view, take=str(i >= half)) for i, view in enumerate(views(stops))]
    fitted_factors = factors(1.0, stops=np.concatenate([STOPS[::2], STOPS[::2]]))
    found = camera_response(fitted_factors, taken)
    assert found is not None and found.exponent == pytest.approx(1, abs=1e-3) and not found.differs
    assert found.recorded_stops == pytest.approx(np.ptp(STOPS[::2]), abs=1e-3)
    one_take = camera_response(fitted_factors, views(stops))
    assert one_take is not None and one_take.exponent < 0.9


def test_too_little_is_none() -> None:
    assert camera_response(factors(0.7), [replace(view, recorded_exposure=None) for view in views()]) is None
    few = np.linspace(-1, 1, MIN_PHOTOGRAPHS - 1)
    assert camera_response(factors(0.7, stops=few), views(few)) is None
    alike = 0.1 * STOPS
    assert camera_response(factors(0.7, stops=alike), views(alike)) is None
    assert response_warning(None) is None


@pytest.mark.slow
def test_a_fit_warns_of_a_response_that_is_not_that_of_srgb(tmp_path: Path) -> None:
    """Photographs by a camera whose values are the radiance to the power of 0.7."""
    mesh = ball()
    color = painted(mesh, lambda p: 0.4 + 0.2 * torch.sin(3 * p))[0]
    scene = Scene(mesh, make_material(color), replace(sky(), radiance=0.4 * sky().radiance))
    taken = photographs(scene, around(12))
    for power, warned in ((0.7, True), (1.0, False)):
        exposed = []
        for view, stops in zip(taken.views, np.random.default_rng(1).permutation(STOPS), strict=True):
            pixels, exposure = view.read(), float(2**stops)
            shown = (pixels.color_linear * exposure).clip(0, 1) ** power
            stored = replace(pixels, color_linear=shown.astype(np.float32), saturated=(shown >= 1).any(axis=2))
            exposed.append(replace(view, read=lambda p=stored: p, recorded_exposure=exposure))  # type: ignore[misc]
        warnings: list[str] = []
        capture = Capture(Path("made"), tuple(exposed))
        _, report = fitted(mesh, capture, tmp_path / str(power), warnings=warnings, model="diffuse", exposures="fitted")
        assert report.exposures is not None and report.exposures.response is not None
        assert report.exposures.response.exponent == pytest.approx(power, abs=0.08)
        assert any("response is not that of sRGB" in text for text in warnings) == warned
