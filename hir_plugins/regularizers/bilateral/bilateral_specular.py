"""Bilateral smoothness of the specular albedo, guided by position and diffuse albedo (Zhu et al. 2023)."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, final

from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Scene
from hir_plugins.regularizers.bilateral.bilateral_term import BilateralEnergy, surface_filter
from hir_plugins.regularizers.material_options import BilateralSpecularOptions

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy


@final
class BilateralSpecular(Regularizer):
    """`R = Σ_p ‖ρs[p] − Σ_q k_pq ρs[q] / Σ_q k_pq‖₁`, `k_pq = exp(−‖p−q‖²/2σ1² − ‖ρd[p]−ρd[q]‖²/2σ2²)`.

    q runs over all samples including p. The gradient reaches ρs, and ρd through k. A constant ρs has no energy. For a
    material with one ρs for the whole surface the term has no effect, and a warning says so.
    """

    def __init__(self, config: BilateralSpecularOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        config, material = self._config, scene.material
        if material is None:
            raise StageError("bilateral_specular needs a material; it belongs to the reflectance stage")
        if material.specular_albedo.ndim == 1:
            warnings.warn(
                "regularizer bilateral_specular has no effect: the model has one specular albedo for the whole surface "
                "(a map: --set reflectance.model=specular_map)",
                stacklevel=2,
            )
            return _nothing
        smoothing = surface_filter(scene.mesh, material.specular_albedo.shape, config)

        factor = 1 / max(len(smoothing.samples.positions), 1) if config.average else 1.0

        def shown(scene: Scene) -> tuple[Tensor, Tensor]:
            assert scene.material is not None
            diffuse = smoothing.samples.values(scene.material.diffuse_albedo) / config.sigma_albedo
            return diffuse, factor * smoothing.samples.values(scene.material.specular_albedo)

        return BilateralEnergy(smoothing, shown)


def _nothing(scene: Scene) -> Float[Tensor, ""]:
    assert scene.material is not None
    return scene.material.specular_albedo.sum() * 0
