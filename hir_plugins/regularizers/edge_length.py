"""The paper's term on edge lengths."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Mesh, Scene
from hir_plugins.regularizers.mesh_options import EdgeLengthOptions

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy


@final
class EdgeLength(Regularizer):
    """`sqrt(Σ e²)` over all edges (Zhu et al. 2023, L_edge)."""

    def __init__(self, config: EdgeLengthOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        initial = float(_root_of_squares(scene.mesh).detach()) if self._config.scale_free else 1.0
        unit = initial if initial > 0 else 1.0

        def energy(scene: Scene) -> Float[Tensor, ""]:
            return _root_of_squares(scene.mesh) / unit

        return energy


def _root_of_squares(mesh: Mesh) -> Float[Tensor, ""]:
    a, b = mesh.positions[mesh.topology.edges].unbind(1)
    total = (b - a).square().sum()
    # the root's gradient at 0 is 0/0; here a mesh of points has no gradient
    return torch.where(total > 0, total, 1.0).sqrt() * (total > 0)
