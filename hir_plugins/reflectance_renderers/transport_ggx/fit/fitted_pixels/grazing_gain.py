"""Errors of views whose predictions may brighten towards grazing angles, as rough and fuzzy surfaces do.

No model here has this brightening: retroreflection of rough surfaces (Oren & Nayar 1994; Burley 2012), or fibres. A
light that moves with the camera imitates it, because its shading depends on the angle of view. It is a factor of the
radiance, 1 + g (1 − cos θ)⁵ for the angle θ between normal and view (the power of Schlick 1994), with 0 ≤ g ≤ 1. A lamp
on the camera darkens towards grazing angles, which this factor cannot imitate. The g of each view is the one that suits
the other views best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelColors

GAINS = 11
"""Values of g that are compared."""

ErrorsOfViews = Callable[[Sequence[Float[Tensor, "P 3"]]], Float[Tensor, " V"]]
"""From the radiance of pixels, in one or two independent renderings, to the mean squared error of each view."""


def grazing_gain(cosine: Float[Tensor, " P"], gain: float) -> Float[Tensor, "P 1"]:
    """The factor at the cosine between normal and view."""
    return (1 + gain * (1 - cosine.clamp(0, 1)) ** 5)[:, None]


def errors_with_grazing_gain(
    pixels: PixelColors, renderings: Sequence[Float[Tensor, "P 3"]], errors: ErrorsOfViews
) -> Float[Tensor, " V"]:
    """The errors of V views, each with the g that has the least error in the others; with g = 0 for a single view.

    The factor is scaled so that the mean radiance stays as it is.
    """
    mean = renderings[0].mean()
    table = []
    for gain in torch.linspace(0, 1, GAINS).tolist():
        factor = grazing_gain(pixels.view_cosine, gain)
        factor = factor * (mean / (factor * renderings[0]).mean().clamp_min(1e-12) if mean > 0 else 1.0)
        table.append(errors([each * factor for each in renderings]))
    by_gain = torch.stack(table)
    others = by_gain.sum(dim=1, keepdim=True) - by_gain
    best = others.argmin(dim=0) if by_gain.shape[1] > 1 else torch.zeros(1, dtype=torch.long, device=by_gain.device)
    return by_gain.gather(0, best[None])[0]
