"""Joint bilateral smoothness: near points that are similar in all maps of the material are pulled together."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.errors import StageError
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Material, Scene
from hir_plugins.regularizers.bilateral.bilateral_term import BilateralEnergy, surface_filter
from hir_plugins.regularizers.material_options import JointBilateralOptions

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy

MAPS = ("diffuse_albedo", "specular_albedo", "roughness")


@final
class JointBilateral(Regularizer):
    """`mean_p Σ_c w_c |c[p] − Σ_q k_pq c[q] / Σ_q k_pq|` over the channels c of all maps (Tomasi, Manduchi 1998).

    `k_pq = exp(−‖p−q‖²/2σ² − Σ_c (c[p]−c[q])²/2σ_c²)`: every map guides every other and itself. The gradient is that of
    the value, through k too. A constant map has no energy and guides nothing.
    """

    def __init__(self, config: JointBilateralOptions) -> None:
        self._config = config
        self._widths = {
            "diffuse_albedo": config.sigma_diffuse,
            "specular_albedo": config.sigma_specular,
            "roughness": config.sigma_roughness,
        }

    def prepare(self, scene: Scene) -> Energy:
        if scene.material is None:
            raise StageError("joint_bilateral needs a material; it belongs to the reflectance stage")
        names = [name for name in MAPS if getattr(scene.material, name).ndim > 1]
        weights = {name: getattr(self._config, name) for name in names}
        if not any(weights.values()):
            warnings.warn("regularizer joint_bilateral has no effect: no map with a weight is a texture", stacklevel=2)
            return _nothing
        smoothing = surface_filter(scene.mesh, _largest(scene.material, names), self._config)

        factor = 1 / max(len(smoothing.samples.positions), 1)

        def shown(scene: Scene) -> tuple[Tensor, Tensor]:
            values = {name: smoothing.samples.values(getattr(scene.material, name)) for name in names}
            guide = torch.cat([values[name] / self._widths[name] for name in names], dim=1)
            return guide, torch.cat([factor * values[name] * weights[name] for name in names], dim=1)

        return BilateralEnergy(smoothing, shown)


def _largest(material: Material, names: list[str]) -> Sequence[int]:
    """Shape of the finest map: its texels are the samples."""
    shapes: list[Sequence[int]] = [tuple(getattr(material, name).shape) for name in names]
    return max(shapes, key=lambda shape: shape[0] * shape[1])


def _nothing(scene: Scene) -> Float[Tensor, ""]:
    assert scene.material is not None
    return scene.material.diffuse_albedo.sum() * 0
