"""The proximal step of a closed form: near its solution, in the metric of its equations, a further term is minimised.

`argmin_x ½ Σ c (x − x₀)² + E(x)` for a diagonal curvature c. Newton's step of the first part, `(c (x − x₀) + ∇E) / c`,
is limited in each element, and the limit falls geometrically: that needs no curvature of E and no smoothness, converges
for absolute values like total variation, and is continuous in the weight of E. The best of all steps is returned.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

STEPS = 24
"""Evaluations of E and its gradient, each."""
FIRST_LIMIT, LAST_LIMIT = 0.1, 5e-4
"""Of the change of a value of 0…1 in a step; together they reach 0.5."""
CURVATURE_FLOOR = 0.01
"""Share of the mean curvature below which the steps do not follow it: there E alone decides."""


def proximal_step(
    start: Float[Tensor, "N C"],
    curvature: Float[Tensor, "N C"],
    energy: Callable[[Float[Tensor, "N C"]], Float[Tensor, ""]],
) -> Float[Tensor, "N C"]:
    """The minimiser, in 0…1; never worse than `start`. A gradient of E that is not finite ends the steps."""
    metric = torch.maximum(curvature, CURVATURE_FLOOR * curvature.mean()).clamp_min(torch.finfo(curvature.dtype).tiny)
    x, best, least = start, start, float("inf")
    for step in range(STEPS + 1):
        leaf = x.detach().clone().requires_grad_()
        with torch.enable_grad():
            term = energy(leaf)
            slope = torch.autograd.grad(term, leaf, allow_unused=True)[0] if term.requires_grad else None
        if slope is None:
            return best
        offset = leaf.detach() - start
        value = 0.5 * float((curvature * offset.square()).double().sum()) + float(term.detach())
        if value < least:
            best, least = leaf.detach(), value
        newton = (curvature * offset + slope) / metric
        if step == STEPS or not bool(torch.isfinite(newton).all()):
            break
        limit = FIRST_LIMIT * (LAST_LIMIT / FIRST_LIMIT) ** (step / (STEPS - 1))
        x = (leaf.detach() - newton.clamp(-limit, limit)).clamp(0, 1)
    return best
