"""The proximal step of a closed form: near its solution, in the metric of its equations, a further term is minimised.

`argmin_x ½ Σ c (x − x₀)² + E(x)` for a diagonal curvature c. Newton's step of the first part, `(c (x − x₀) + ∇E) / c`,
is limited in each element, and the limit falls geometrically: that needs no curvature of E and no smoothness, converges
for absolute values like total variation, and is continuous in the weight of E. The best of all steps is returned.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import torch
from jaxtyping import Float
from torch import Tensor

STEPS = 24
"""Evaluations of E and its gradient, each."""
SLOW_STEPS = 5
"""A slow part of E is evaluated with its gradient every so many steps; in between it is linear."""
FIRST_LIMIT, LAST_LIMIT = 0.1, 5e-4
"""Of the change of a value of 0…1 in a step; together they reach 0.5."""
CURVATURE_FLOOR = 0.01
"""Share of the mean curvature below which the steps do not follow it: there E alone decides."""

Energy: TypeAlias = Callable[[Tensor], Tensor]
"""Of values (N, C): a scalar."""


def proximal_step(
    start: Float[Tensor, "N C"],
    curvature: Float[Tensor, "N C"],
    energy: Energy,
    slow: Energy | None = None,
) -> Float[Tensor, "N C"]:
    """The minimiser, in 0…1; never worse than `start`. A gradient of E that is not finite ends the steps.

    E is the sum of `energy` and `slow`. Only steps at which `slow` is evaluated are compared.
    """
    metric = torch.maximum(curvature, CURVATURE_FLOOR * curvature.mean()).clamp_min(torch.finfo(curvature.dtype).tiny)
    x = start.detach()
    best, least = start, float("inf")
    lagged = None
    for step in range(STEPS + 1):
        term, slope = _value_and_slope(energy, x)
        compared = slow is None or step % SLOW_STEPS == 0 or step == STEPS
        if slow is not None:
            if lagged is None or compared:
                lagged = x, *_value_and_slope(slow, x)
            at, value_there, slope_there = lagged
            if slope_there is not None:
                slope = slope_there if slope is None else slope + slope_there
                term += value_there + float(((x - at) * slope_there).double().sum())
        if slope is None:
            return best
        offset = x - start
        value = 0.5 * float((curvature * offset.square()).double().sum()) + term
        if compared and value < least:
            best, least = x, value
        newton = (curvature * offset + slope) / metric
        if step == STEPS or not bool(torch.isfinite(newton).all()):
            break
        limit = FIRST_LIMIT * (LAST_LIMIT / FIRST_LIMIT) ** (step / (STEPS - 1))
        x = (x - newton.clamp(-limit, limit)).clamp(0, 1)
    return best


def _value_and_slope(energy: Energy, x: Float[Tensor, "N C"]) -> tuple[float, Float[Tensor, "N C"] | None]:
    """Without a slope where the energy does not depend on x."""
    leaf = x.detach().clone().requires_grad_()
    with torch.enable_grad():
        term = energy(leaf)
        slope = torch.autograd.grad(term, leaf, allow_unused=True)[0] if term.requires_grad else None
    return float(term.detach()), slope
