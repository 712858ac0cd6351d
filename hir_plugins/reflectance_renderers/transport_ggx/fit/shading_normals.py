"""Normals that differ from the mesh's: dents and threads finer than its triangles, as vectors at vertices.

A tilt is any vector; its part along the mesh's normal does nothing, so that tilts of neighbours can be mixed without
frames. The irradiance of a bent normal follows from the light's vector irradiance (Gershun 1939); the horizon stays the
mesh's.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

STEEPEST = 1.5
"""Longest tilt along the surface: 56° from the mesh's normal."""


def bent(normal: Float[Tensor, "P 3"], tilt: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    """Unit normals tilted by the parts of `tilt` along the surface; finite, with finite derivatives, for any tilt."""
    along = tilt - (tilt * normal).sum(dim=1, keepdim=True) * normal
    length = (along.square().sum(dim=1, keepdim=True) + 1e-20).sqrt()
    along = along * (STEEPEST / length.clamp_min(STEEPEST))
    return torch.nn.functional.normalize(normal + along, dim=1, eps=1e-12)


def bent_irradiance(
    normal: Float[Tensor, "P 3"],
    bent_normal: Float[Tensor, "P 3"],
    irradiance: Float[Tensor, "P C"],
    vectors: Float[Tensor, "P 3 C"],
) -> Float[Tensor, "P C"]:
    """Irradiance of bent normals, from that of the mesh's and the vector irradiance; not below 0.

    The product of both vectors counts light from behind the bent normal as negative. Half of what the cosine between
    the normals takes is given back for it: right where light is even, (1 − cosine) / 2 too much of a lamp ahead.
    """
    cosine = (normal * bent_normal).sum(dim=1, keepdim=True)
    along = bent_normal - cosine * normal
    return ((1 + cosine) / 2 * irradiance + (along[:, :, None] * vectors).sum(dim=1)).clamp_min(0)
