"""The rule for clipped pixels, in torch; `drjit_clipped_pixels` in the reflectance renderers is the same for Dr.Jit.

Where the sensor saturated, the true radiance is at least the recorded one. So a prediction that is brighter has no
error, and one that is darker has its full error.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def is_clipped_excess(difference: Float[Tensor, "*b"], clipped: Bool[Tensor, "*#b"]) -> Bool[Tensor, "*b"]:
    """Where `difference` (prediction minus photograph) is no error, because the photograph is `clipped`."""
    return clipped & (difference > 0)


def without_clipped_excess(difference: Float[Tensor, "*b"], clipped: Bool[Tensor, "*#b"]) -> Float[Tensor, "*b"]:
    """`difference` (prediction minus photograph), with 0 where `is_clipped_excess`."""
    return torch.where(is_clipped_excess(difference, clipped), torch.zeros_like(difference), difference)
