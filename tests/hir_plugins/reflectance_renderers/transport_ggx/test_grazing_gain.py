"""Errors for comparisons between lights: brightening towards grazing angles is left out, darkening is not."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.grazing_gain import (
    errors_with_grazing_gain,
    grazing_gain,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelColors, srgb_residual

VIEWS = 3
COSINE = torch.linspace(0.1, 1, 300).repeat(VIEWS)
VIEW = torch.arange(VIEWS).repeat_interleave(300)
PREDICTED = torch.full((len(COSINE), 3), 0.3)


def photographed(radiance: Tensor) -> PixelColors:
    return PixelColors(linear_to_srgb(radiance), torch.zeros(radiance.shape, dtype=torch.bool), VIEW, COSINE)


def errors_of(pixels: PixelColors) -> tuple[Tensor, Tensor]:
    """Without and with the gain."""

    def errors(shown: Sequence[Tensor]) -> Tensor:
        squares = (srgb_residual(pixels, shown[0]) * srgb_residual(pixels, shown[-1])).mean(dim=1)
        return torch.stack([squares[pixels.view == view].mean() for view in range(VIEWS)])

    return errors([PREDICTED]), errors_with_grazing_gain(pixels, [PREDICTED, PREDICTED], errors)


@pytest.mark.parametrize("gain", [0.2, 0.7, 1.0])
def test_brightening_is_left_out(gain: float) -> None:
    """Of a fit whose mean is right, as fits are: its albedo has the mean of the brightening."""
    factor = grazing_gain(COSINE, gain)
    plain, corrected = errors_of(photographed(PREDICTED * factor / factor.mean()))
    assert float(plain.min()) > 1e-5
    assert float(corrected.max()) < 1e-6


def test_the_darkening_of_a_lamp_on_the_camera_is_not() -> None:
    plain, corrected = errors_of(photographed(PREDICTED * COSINE[:, None] / COSINE.mean()))
    torch.testing.assert_close(corrected, plain)


def test_a_view_does_not_choose_its_own_gain() -> None:
    """One view brightens, two do not: it keeps its whole error, and they take no gain that they do not need."""
    factor = torch.where((VIEW == 0)[:, None], grazing_gain(COSINE, 1.0), torch.ones(1))
    plain, corrected = errors_of(photographed(PREDICTED * factor))
    torch.testing.assert_close(corrected[0], plain[0])


def test_one_view_has_no_other_to_choose_by() -> None:
    few = VIEW == 0
    factor = grazing_gain(COSINE, 0.5)
    whole = photographed(PREDICTED * factor)
    pixels = PixelColors(*(getattr(whole, name)[few] for name in PixelColors.__dataclass_fields__))

    def errors(shown: Sequence[Tensor]) -> Tensor:
        return srgb_residual(pixels, shown[0]).square().mean()[None]

    torch.testing.assert_close(errors_with_grazing_gain(pixels, [PREDICTED[few]], errors), errors([PREDICTED[few]]))


@pytest.mark.parametrize("radiance", [0.0, 1e-30, 1e30])
def test_black_and_bright_predictions_have_finite_errors(radiance: float) -> None:
    pixels = photographed(PREDICTED)

    def errors(shown: Sequence[Tensor]) -> Tensor:
        return torch.stack([srgb_residual(pixels, shown[0].clamp(0, 1)).square().mean()] * VIEWS)

    found = errors_with_grazing_gain(pixels, [torch.full_like(PREDICTED, radiance)], errors)
    assert bool(torch.isfinite(found).all())
