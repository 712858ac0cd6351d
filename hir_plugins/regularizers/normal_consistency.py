"""The paper's term on the angles between neighbouring triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Scene

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy


@final
class NormalConsistency(Regularizer):
    """`Σ (1 − n_i·n_j)²` over faces that share an edge (Zhu et al. 2023, L_normal); no scale changes it."""

    def __init__(self, config: NoOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        pairs = scene.mesh.topology.face_pairs

        def energy(scene: Scene) -> Float[Tensor, ""]:
            p = scene.mesh.positions[scene.mesh.faces]
            first, second = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
            # in a scene of millimetres the squares of areas underflow in float32; ratios of edges do not
            size = torch.maximum(first.detach().norm(dim=1), second.detach().norm(dim=1))[:, None]
            scale = size.clamp_min(torch.finfo(p.dtype).tiny)
            normals = torch.linalg.cross(first / scale, second / scale)
            length2 = normals.square().sum(dim=1)
            # the normal of a needle triangle is noise with an unbounded gradient: it is left out
            valid = length2 > 1e-10
            unit = normals * torch.where(valid, length2, 1.0).rsqrt()[:, None]
            cosine = (unit[pairs[:, 0]] * unit[pairs[:, 1]]).sum(dim=1)
            both = valid[pairs[:, 0]] & valid[pairs[:, 1]]
            return torch.where(both, 1 - cosine, 0.0).square().sum()

        return energy
