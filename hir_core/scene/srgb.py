"""The sRGB transfer function on tensors, differentiable everywhere; for arrays: `hir_exporters.conventions`."""

from __future__ import annotations

import torch
from hir_exporters.conventions import SRGB_POWER
from jaxtyping import Float
from torch import Tensor

_TOE, _TOE_ENCODED = 0.0031308, 0.04045


def linear_to_srgb(linear: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Encodes linear values; the curve continues beyond 1, negative values become 0."""
    linear = linear.clamp_min(0)
    # the power has an infinite slope at 0, which `where` would turn into NaN, so its argument is bounded below
    return torch.where(linear <= _TOE, 12.92 * linear, 1.055 * linear.clamp_min(_TOE) ** (1 / SRGB_POWER) - 0.055)


def srgb_to_linear(encoded: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The inverse of `linear_to_srgb`."""
    bright = ((encoded.clamp_min(_TOE_ENCODED) + 0.055) / 1.055) ** SRGB_POWER
    return torch.where(encoded <= _TOE_ENCODED, encoded / 12.92, bright)


def srgb_slope(linear: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Derivative of `linear_to_srgb` where it is not negative."""
    bright = 1.055 / SRGB_POWER * linear.clamp_min(_TOE) ** (1 / SRGB_POWER - 1)
    return torch.where(linear <= _TOE, torch.full_like(linear, 12.92), bright)
