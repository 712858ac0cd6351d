"""Samples of the surface at which textures are compared: vertices or texels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.errors import StageError
from hir_core.mesh.texel_rasterization import texel_surface
from hir_core.scene import Mesh, Texture
from hir_core.scene.bilinear import axis_neighbours


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Fixed points of the surface."""

    positions: Float[Tensor, "N 3"]
    uvs: Float[Tensor, "N 2"]
    """Not used for maps at vertices."""
    vertices: Int[Tensor, " N"] | None = None
    """The vertices that the samples are; None for texels."""

    def values(self, texture: Texture | Float[Tensor, "V C"]) -> Float[Tensor, "N C"]:
        """The map at the samples; a constant is repeated. Differentiable.

        A texture is bilinear and wrapping; of a map at vertices the samples are vertices.
        """
        if texture.ndim == 1:
            return texture.expand(len(self.positions), -1)
        if texture.ndim == 2:
            assert self.vertices is not None, "samples of a map at vertices are vertices"
            return texture[self.vertices]
        height, width = texture.shape[:2]
        uvs = self.uvs.to(texture.dtype)
        x = axis_neighbours(uvs[:, 0] * width - 0.5, width, "repeat")
        y = axis_neighbours(uvs[:, 1] * height - 0.5, height, "repeat")
        s, t = x.fraction[:, None], y.fraction[:, None]
        # interpolation by differences: a constant texture gives exactly equal values
        upper = texture[y.low, x.low] + (texture[y.low, x.high] - texture[y.low, x.low]) * s
        lower = texture[y.high, x.low] + (texture[y.high, x.high] - texture[y.high, x.low]) * s
        return upper + (lower - upper) * t


def sample_surface(mesh: Mesh, kind: Literal["vertices", "texels"], size: tuple[int, int] | None) -> SurfaceSamples:
    """The vertices that faces use, or the covered texels of a texture of `size` (height, width).

    Without a size, for maps at vertices, always the vertices.
    """
    positions = mesh.positions.detach()
    if size is None:
        used = torch.unique(mesh.faces)
        return SurfaceSamples(positions[used], positions.new_zeros(len(used), 2), used)
    uvs, uv_faces = mesh.uvs, mesh.topology.uv_faces
    if uvs is None or uv_faces is None:
        raise StageError("textures can only be compared on a mesh with texture coordinates; let the atlas stage run")
    if kind == "texels":
        surface = texel_surface(mesh, size)
        row, column = surface.covered.nonzero(as_tuple=True)
        centres = torch.stack([(column + 0.5) / size[1], (row + 0.5) / size[0]], dim=1)
        return SurfaceSamples(surface.position.detach(), centres.to(positions))
    # at a seam a vertex has several texture coordinates; any of them serves, if it is the same one on every device
    corner = torch.zeros(len(positions), dtype=torch.long, device=positions.device)
    corner = corner.scatter_reduce(0, mesh.faces.reshape(-1), uv_faces.reshape(-1), "amax")
    used = torch.unique(mesh.faces)
    return SurfaceSamples(positions[used], uvs.detach()[corner[used]], used)
