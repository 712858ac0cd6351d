"""The GGX width of a lobe, found by comparing the losses of neighbouring widths, each with lobes of its own.

Gradients do not find it: for directions that were drawn at one width, another width changes only the weights, and that
noise raises the loss on both sides, more than the wrong width does (docs/studies/lobe_width.md).

Of a map the mean is searched. What differs from the mean has gradients, from lobes that are drawn for them. Gradients
alone make the whole map narrower than the losses of neighbouring maps ask for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MIN_ALPHA, Parameters, logit_of_alpha

LOG_STEP: Final = math.log(1.2)
"""Distance of the compared widths, as a difference of logarithms."""
OVER_RELAXATION: Final = 1.5
"""Multiple of the step to the minimum for the present light. The light is fitted to the present width, so the minimum
of both lies farther in the same direction. Below 2, or the search would not converge under a known light."""
MAX_ALPHA: Final = 0.95


def searched_width(parameters: Parameters, loss_of: Callable[[Parameters], float]) -> Float[Tensor, "#V 1"]:
    """The unconstrained width after one step of the search, with light and albedos as they are. Every α of a map
    changes by the same factor.

    `loss_of` draws lobes for the parameters that it gets, with the same random numbers each time, and returns the loss
    of the pixels. The three losses give a parabola of the logarithm of α.
    """
    alpha = parameters.alpha.detach()

    def at(step: float) -> Float[Tensor, "#V 1"]:
        return logit_of_alpha((alpha * math.exp(step)).clamp(MIN_ALPHA, MAX_ALPHA))

    below, here, above = (loss_of(replace(parameters, width=at(step))) for step in (-LOG_STEP, 0.0, LOG_STEP))
    return at(OVER_RELAXATION * step_to_minimum(below, here, above) * LOG_STEP)


def step_to_minimum(below: float, here: float, above: float) -> float:
    """Where the parabola through values at -1, 0 and 1 is least, within -1…1; 0 where a value is not finite."""
    if not all(math.isfinite(value) for value in (below, here, above)):
        return 0.0
    slope, curvature = (above - below) / 2, above - 2 * here + below
    if abs(slope) >= curvature:
        return float((slope < 0) - (slope > 0))
    return -slope / curvature
