"""Samples of the surface at which textures are compared: vertices or texels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.mesh.texel_rasterization import texel_surface
from hir_core.scene import Mesh, Texture


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Fixed points of the surface."""

    positions: Float[Tensor, "N 3"]
    uvs: Float[Tensor, "N 2"]

    def values(self, texture: Texture) -> Float[Tensor, "N C"]:
        """The texture at the samples, bilinear and wrapping; a constant is repeated. Differentiable."""
        if texture.ndim == 1:
            return texture.expand(len(self.positions), -1)
        height, width = texture.shape[:2]
        uvs = self.uvs.to(texture.dtype)
        x, y = uvs[:, 0] * width - 0.5, uvs[:, 1] * height - 0.5
        left, top = x.floor(), y.floor()
        s, t = (x - left)[:, None], (y - top)[:, None]
        columns = left.long() % width, (left.long() + 1) % width
        rows = top.long() % height, (top.long() + 1) % height
        # interpolation by differences: a constant texture gives exactly equal values
        upper = texture[rows[0], columns[0]] + (texture[rows[0], columns[1]] - texture[rows[0], columns[0]]) * s
        lower = texture[rows[1], columns[0]] + (texture[rows[1], columns[1]] - texture[rows[1], columns[0]]) * s
        return upper + (lower - upper) * t


def sample_surface(mesh: Mesh, kind: Literal["vertices", "texels"], size: tuple[int, int]) -> SurfaceSamples:
    """The vertices that faces use, or the covered texels of a texture of `size` (height, width)."""
    uvs, uv_faces = mesh.uvs, mesh.topology.uv_faces
    if uvs is None or uv_faces is None:
        raise StageError("textures can only be compared on a mesh with texture coordinates; let the atlas stage run")
    positions = mesh.positions.detach()
    if kind == "texels":
        surface = texel_surface(mesh, size)
        row, column = surface.covered.nonzero(as_tuple=True)
        centres = torch.stack([(column + 0.5) / size[1], (row + 0.5) / size[0]], dim=1)
        return SurfaceSamples(surface.position.detach(), centres.to(positions))
    # at a seam a vertex has several texture coordinates; any of them serves
    corner = torch.zeros(len(positions), dtype=torch.long, device=positions.device)
    corner[mesh.faces.reshape(-1)] = uv_faces.reshape(-1)
    used = torch.unique(mesh.faces)
    return SurfaceSamples(positions[used], uvs.detach()[corner[used]])
