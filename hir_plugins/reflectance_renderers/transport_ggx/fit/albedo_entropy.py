"""Prior of the albedo: objects have few different colours.

Neighbouring vertices alone do not tell a slow change of the albedo from shading. A light that is wrong leaves shading
in the albedo, and with it more different values than the true one has (Barron and Malik 2015, "parsimony").
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

BANDWIDTH = 0.1
"""Of the kernel density of the albedo's logarithm: values this far apart count as one."""
MIN_LOG_ALBEDO = -7.0
"""Albedos below a thousandth are one value: black."""
SAMPLED_VERTICES = 512
"""Drawn at each step: the entropy compares all pairs of them."""


def albedo_entropy(logit: Float[Tensor, "V 3"], seed: tuple[int, int]) -> Float[Tensor, ""]:
    """Rényi's quadratic entropy, −log of the mean of exp(−|aᵢ − aⱼ|² / 4·BANDWIDTH²) over pairs of sampled vertices.

    `logit`: logits of the albedo a, whose logarithm is compared. `seed`: of the fit, and the number of the step. 0
    where all albedos are equal.
    """
    count = min(SAMPLED_VERTICES, len(logit))
    rows = torch.from_numpy(np.random.default_rng(seed).integers(len(logit), size=count)).to(logit.device)
    log_albedo = torch.nn.functional.logsigmoid(logit.index_select(0, rows)).clamp_min(MIN_LOG_ALBEDO)
    entropy: Tensor = _QuadraticEntropy.apply(log_albedo / BANDWIDTH)
    return entropy


class _QuadraticEntropy(torch.autograd.Function):
    """−log mean exp(−|xᵢ − xⱼ|² / 4) with its gradient: four times faster than through the graph of all pairs."""

    @staticmethod
    def forward(ctx: Any, x: Float[Tensor, "N D"]) -> Float[Tensor, ""]:
        x = x - x.mean(dim=0)  # squares of nearly equal values would lose their difference
        quarter = x.square().sum(dim=1, keepdim=True) / -4
        one = torch.ones_like(quarter)
        # one product gives xᵢ·xⱼ / 2 − |xᵢ|² / 4 − |xⱼ|² / 4: each further operation on all pairs takes as long
        kernel = (torch.cat([x / 2, quarter, one], dim=1) @ torch.cat([x, one, quarter], dim=1).T).clamp_max_(0).exp_()
        sums = kernel @ torch.cat([x, one], dim=1)
        of_each = sums[:, -1:]
        total = of_each.sum()
        ctx.save_for_backward((x * of_each - sums[:, :-1]) / total)
        return -(total / len(x) ** 2).log()

    @staticmethod
    def backward(ctx: Any, *gradient: Tensor) -> Tensor:
        (of_x,) = ctx.saved_tensors
        return gradient[0] * of_x
