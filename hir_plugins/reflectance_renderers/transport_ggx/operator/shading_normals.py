"""Shading normals that differ from the mesh's: detail finer than its triangles, as offset vectors at vertices.

A normal offset is any vector; its part along the mesh's normal has no effect, so that offsets of neighbours can be
interpolated without tangent frames. The irradiance for a shading normal follows from the light's vector irradiance
(Gershun 1939); occlusion remains that of the mesh's normal.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

MAX_NORMAL_OFFSET = 1.5
"""Longest offset along the surface: 56° from the mesh's normal."""


def offset_normals(normal: Float[Tensor, "P 3"], normal_offset: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    """Unit normals moved by the parts of `normal_offset` along the surface; finite, with finite derivatives."""
    along = normal_offset - (normal_offset * normal).sum(dim=1, keepdim=True) * normal
    length = (along.square().sum(dim=1, keepdim=True) + 1e-20).sqrt()
    along = along * (MAX_NORMAL_OFFSET / length.clamp_min(MAX_NORMAL_OFFSET))
    return torch.nn.functional.normalize(normal + along, dim=1, eps=1e-12)


def shading_normal_irradiance(
    normal: Float[Tensor, "P 3"],
    shading_normal: Float[Tensor, "P 3"],
    irradiance: Float[Tensor, "P C"],
    vectors: Float[Tensor, "P 3 C"],
) -> Float[Tensor, "P C"]:
    """Irradiance for shading normals, from that of the mesh's normals and the vector irradiance; not below 0.

    The product of shading normal and vector irradiance counts light from behind the shading normal as negative. As a
    correction, half of what the cosine between the normals takes away is added: exact for uniform light, and
    (1 − cosine) / 2 too much for a lamp ahead.
    """
    cosine = (normal * shading_normal).sum(dim=1, keepdim=True)
    along = shading_normal - cosine * normal
    return ((1 + cosine) / 2 * irradiance + (along[:, :, None] * vectors).sum(dim=1)).clamp_min(0)
