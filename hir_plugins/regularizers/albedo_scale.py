"""Holds the mean diffuse albedo where it was: no photograph tells a dark surface in much light from the opposite."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.mesh.texel_rasterization import texel_surface
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Scene
from hir_plugins.regularizers.material_options import AlbedoScaleOptions

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy

DARKEST = 1e-4
"""Added to albedos before their logarithm: black has a finite slope."""


@final
class AlbedoScale(Regularizer):
    """`(ln m − ln m₀)²`, m the mean of ρd over the covered texels, m₀ what it was at the start of the stage.

    Nothing but the common factor of all albedos (with `per_channel` their common tint) is held: differences between
    places cost nothing.
    """

    def __init__(self, config: AlbedoScaleOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        if scene.material is None:
            raise StageError("albedo_scale needs a material; it belongs to the reflectance stage")
        texture = scene.material.diffuse_albedo
        covered = None
        if texture.ndim == 3:
            covered = texel_surface(scene.mesh, (texture.shape[0], texture.shape[1])).covered
            covered = covered if bool(covered.any()) else torch.ones_like(covered)
        start = self._level(texture.detach(), covered)

        def energy(scene: Scene) -> Float[Tensor, ""]:
            assert scene.material is not None
            return (self._level(scene.material.diffuse_albedo, covered) - start).square().mean()

        return energy

    def _level(self, texture: Tensor, covered: Tensor | None) -> Tensor:
        mean = texture if covered is None else texture[covered].mean(dim=0)
        return ((mean if self._config.per_channel else mean.mean()) + DARKEST).log()
