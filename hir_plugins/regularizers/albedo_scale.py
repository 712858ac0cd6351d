"""Keeps the mean diffuse albedo: photographs cannot distinguish a dark surface in bright light from the opposite."""

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

LOG_OFFSET_ALBEDO = 1e-4
"""Added to the mean albedo before its logarithm, so that black has a finite slope."""


@final
class AlbedoScale(Regularizer):
    """`(ln m − ln m₀)²` with m the mean of ρd over the covered texels and m₀ its initial value.

    Only the common factor of all albedos is constrained (with `per_channel` the common factor of each channel), not
    their differences.
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
        initial = self._log_mean(texture.detach(), covered)

        def energy(scene: Scene) -> Float[Tensor, ""]:
            assert scene.material is not None
            return (self._log_mean(scene.material.diffuse_albedo, covered) - initial).square().mean()

        return energy

    def _log_mean(self, texture: Tensor, covered: Tensor | None) -> Tensor:
        mean = texture if covered is None else texture[covered].mean(dim=0)
        return ((mean if self._config.per_channel else mean.mean()) + LOG_OFFSET_ALBEDO).log()
