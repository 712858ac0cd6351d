"""Exposures of photographs beside the radiance that a fit predicts for them."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from hir_exporters.conventions import SRGB_POWER
from jaxtyping import Float
from torch import Tensor

from hir_core.capture.relative_exposures import DARKEST
from hir_core.scene.srgb import srgb_to_linear
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelColors


def own_exposures(pixels: PixelColors, radiance: Tensor, views: int) -> Float[Tensor, "views 3"]:
    """The factors that bring each view's radiance closest to its photograph; a held-out view has no fitted ones.

    As sRGB, like the errors that are compared: `hir_core.metrics.nearest_exposure` of each view.
    """
    known = ~pixels.saturated
    photograph, predicted = (
        color.clamp_min(0) ** (1 / SRGB_POWER) for color in (srgb_to_linear(pixels.color_srgb), radiance)
    )
    above, below = (
        radiance.new_zeros(views, 3).index_add(0, pixels.view, predicted * other * known)
        for other in (photograph, predicted)
    )
    return torch.where(below > 0, above / below.clamp_min(1e-12), torch.ones_like(below)) ** SRGB_POWER


def median_exposures(predicted: Iterable[tuple[PixelColors, Tensor]], views: int) -> Float[Tensor, "views 3"]:
    """Logarithms of photograph over radiance: the median over the pixels of each view and channel, 0 without any.

    What the fit does not explain, such as highlights, has little influence on it.
    """
    parts: list[tuple[Tensor, Tensor]] = []
    for pixels, radiance in predicted:
        photograph = srgb_to_linear(pixels.color_srgb)
        seen = ~pixels.saturated & (photograph > DARKEST) & (radiance > DARKEST)
        ratio = photograph.clamp_min(DARKEST).log() - radiance.clamp_min(DARKEST).log()
        parts.append((pixels.view, torch.where(seen, ratio, torch.nan)))
    if not parts:
        return torch.zeros(views, 3)
    view, ratio = (torch.cat([part[k] for part in parts]) for k in range(2))
    found = ratio.new_zeros(views, 3)
    for each in view.unique().tolist():
        found[each] = ratio[view == each].nanmedian(dim=0).values.nan_to_num(0.0)
    return found
