"""The lamp near the camera that a fit starts from."""

from __future__ import annotations

import math

from jaxtyping import Float
from torch import Tensor

INITIAL_EXPONENT_PARAMETER = -1.0
"""An exponent of 1.3: a lobe with a slope, and nearly even over the object."""


INITIAL_RADIUS_PARAMETER = -1.0
"""A radius of 0.03 of the distance to the object."""


def initial_lamp(light: Float[Tensor, "H W 3"]) -> Float[Tensor, " 8"]:
    """`Parameters.lamp` at the camera's centre, as bright on the object as a distant light of the same mean radiance.

    `light` is the logarithm of the radiance.
    """
    brightness = float(light.exp().mean()) * math.pi
    lamp = light.new_zeros(8)
    lamp[:3] = math.log(max(brightness, 1e-6))
    lamp[6], lamp[7] = INITIAL_EXPONENT_PARAMETER, INITIAL_RADIUS_PARAMETER
    return lamp
