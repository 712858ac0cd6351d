"""Keeps the mean diffuse albedo: photographs cannot distinguish a dark surface in bright light from the opposite."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.mesh.texel_rasterization import texel_surface
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Mesh, Scene
from hir_plugins.regularizers.material_options import AlbedoScaleOptions

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy

LOG_OFFSET_ALBEDO = 1e-4
"""Added to the mean albedo before its logarithm, so that black has a finite slope."""


@final
class AlbedoScale(Regularizer):
    """`(ln m − ln m₀)²` with m the mean of ρd over the covered texels, or over the area of a mesh whose vertices have
    values, and m₀ its initial value.

    Only the common factor of all albedos is constrained (with `per_channel` the common factor of each channel), not
    their differences.
    """

    def __init__(self, config: AlbedoScaleOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        if scene.material is None:
            raise StageError("albedo_scale needs a material; it belongs to the reflectance stage")
        texture = scene.material.diffuse_albedo
        weight = None
        if texture.ndim == 3:
            covered = texel_surface(scene.mesh, (texture.shape[0], texture.shape[1])).covered
            weight = (covered if bool(covered.any()) else torch.ones_like(covered)).to(texture)[..., None]
        elif texture.ndim == 2:
            weight = vertex_areas(scene.mesh).to(texture)[:, None]
        initial = self._log_mean(texture.detach(), weight)

        def energy(scene: Scene) -> Float[Tensor, ""]:
            assert scene.material is not None
            return (self._log_mean(scene.material.diffuse_albedo, weight) - initial).square().mean()

        return energy

    def _log_mean(self, texture: Tensor, weight: Tensor | None) -> Tensor:
        mean = texture
        if weight is not None:
            mean = (texture * weight).flatten(0, -2).sum(dim=0) / weight.sum()
        return ((mean if self._config.per_channel else mean.mean()) + LOG_OFFSET_ALBEDO).log()


def vertex_areas(mesh: Mesh) -> Float[Tensor, " V"]:
    """A third of the area of the triangles around each vertex; ones where no triangle has an area."""
    third = mesh.face_areas_normals.detach().norm(dim=1) / 6
    areas = third.new_zeros(len(mesh.positions)).index_add(0, mesh.faces.reshape(-1), third.repeat_interleave(3))
    return areas if bool(areas.sum() > 0) else torch.ones_like(areas)
