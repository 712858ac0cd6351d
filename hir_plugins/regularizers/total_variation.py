"""Total variation of textures and of the light: smooths noise and keeps edges."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.mesh.texel_rasterization import texel_surface
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Mesh, Scene, Texture
from hir_plugins.regularizers.material_options import TotalVariationOptions
from hir_plugins.regularizers.mesh_variation import mesh_variation
from hir_plugins.regularizers.surface_samples import sample_surface

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy

_MAPS = ("diffuse_albedo", "specular_albedo", "roughness")


@final
class TotalVariation(Regularizer):
    """Anisotropic total variation (Rudin, Osher, Fatemi 1992), summed over channels, of piecewise constant maps.

    Textures: length in the unit square of the borders between covered texels times the step across; different
    charts are not compared. Light: the same with lengths on the unit sphere. The energy does not depend on the
    resolution of a map, and constants have none. With `samples = "vertices"` a texture is replaced by its values at the
    vertices, linear between them: `mesh_variation`. So are maps that are given at vertices.
    """

    def __init__(self, config: TotalVariationOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        if scene.material is None:
            raise StageError("total_variation needs a material; it belongs to the reflectance stage")
        weights = {name: getattr(self._config, name) for name in _MAPS}
        covered: dict[tuple[int, int], Tensor] = {}
        for name, weight in weights.items():
            texture = getattr(scene.material, name)
            if weight and texture.ndim == 3 and tuple(texture.shape[:2]) not in covered:
                size = (texture.shape[0], texture.shape[1])
                covered[size] = texel_surface(scene.mesh, size).covered
        shapes = [getattr(scene.material, name).ndim for name, weight in weights.items() if weight]
        if max(shapes, default=1) == 1 and not self._config.environment:
            warnings.warn("regularizer total_variation has no effect: no map with a weight is a texture", stacklevel=2)
        at_vertices = self._at_vertices(scene.mesh, bool(covered)) if self._config.samples == "vertices" else None
        positions, faces = scene.mesh.positions.detach(), scene.mesh.faces
        light_weight = self._config.environment

        def energy(scene: Scene) -> Float[Tensor, ""]:
            assert scene.material is not None
            total = scene.material.diffuse_albedo.new_zeros(())
            for name, weight in weights.items():
                texture = getattr(scene.material, name)
                if weight and texture.ndim == 2:
                    total = total + weight * mesh_variation(positions, faces, texture)
                elif weight and texture.ndim == 3:
                    known = covered[tuple(texture.shape[:2])]
                    variation = at_vertices(texture) if at_vertices else texture_variation(texture, known)
                    total = total + weight * variation
            if light_weight and scene.environment is not None:
                total = total + light_weight * environment_variation(scene.environment.radiance)
            return total

        return energy

    @staticmethod
    def _at_vertices(mesh: Mesh, textured: bool) -> Callable[[Texture], Float[Tensor, ""]] | None:
        if not textured:
            return None
        samples = sample_surface(mesh, "vertices", (1, 1))
        used, faces = torch.unique(mesh.faces, return_inverse=True)
        positions = mesh.positions.detach()[used]
        return lambda texture: mesh_variation(positions, faces, samples.values(texture))


def texture_variation(texture: Float[Tensor, "H W C"], covered: Bool[Tensor, "H W"]) -> Float[Tensor, ""]:
    """Σ of steps between neighbouring covered texels times the length of their border (texture side 1)."""
    height, width = texture.shape[:2]
    across = (texture[:, 1:] - texture[:, :-1]).abs() * (covered[:, 1:] & covered[:, :-1])[..., None]
    down = (texture[1:] - texture[:-1]).abs() * (covered[1:] & covered[:-1])[..., None]
    return across.sum() / height + down.sum() / width


def environment_variation(radiance: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """The same on the unit sphere; columns wrap."""
    height, width = radiance.shape[:2]
    across = (radiance - radiance.roll(1, 1)).abs().sum() * (math.pi / height)
    polar = torch.arange(1, height, dtype=radiance.dtype, device=radiance.device) * (math.pi / height)
    down = (radiance[1:] - radiance[:-1]).abs().sum((1, 2)) * torch.sin(polar)
    return across + down.sum() * (2 * math.pi / width)
