"""Total variation of values at vertices, over the triangles of a mesh: it crosses the seams of an atlas."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor


def mesh_variation(
    positions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], values: Float[Tensor, "V C"]
) -> Float[Tensor, ""]:
    """`Σ_c ∫ |∇f_c| dA / √A` of values interpolated linearly in each triangle; no scale of the mesh changes it.

    In a triangle `A |∇f| = ½ ‖Σ_i f_i e_i‖` with e_i the edge opposite to corner i, which divides by no area. A mesh
    without area has no variation.
    """
    corners = positions.to(values.dtype)[faces]
    edges = corners.roll(1, dims=1) - corners.roll(-1, dims=1)
    area = 0.5 * torch.linalg.cross(edges[:, 0], edges[:, 1]).norm(dim=1).sum()
    if not bool(area > 0):
        return values.sum() * 0
    # relative to the first corner: equal values have a slope of exactly 0
    f = values[faces] - values[faces[:, :1]]
    slope = (f[:, :, :, None] * edges[:, :, None]).sum(dim=1)
    square = slope.square().sum(dim=-1)
    # the root's gradient at 0 is 0/0; here a constant triangle has no gradient
    length = torch.where(square > 0, square, 1.0).sqrt() * (square > 0)
    return 0.5 * length.sum() / area.sqrt()
