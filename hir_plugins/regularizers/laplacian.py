"""The paper's Laplacian term, with uniform or cotangent weights."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.optimization.linear_maps import LinearMap, compressed_sum
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Mesh, Scene
from hir_plugins.regularizers.mesh_options import LaplacianOptions

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy


@final
class Laplacian(Regularizer):
    """`‖L V‖²`: squared offsets of each vertex from the mean of its neighbours (Zhu et al. 2023, L_lap)."""

    def __init__(self, config: LaplacianOptions) -> None:
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        mesh = scene.mesh.with_positions(scene.mesh.positions.detach())
        matrix, weights = mesh_laplacian(mesh, self._config.cotangent, self._config.scale_free)
        laplacian = LinearMap(matrix)

        def energy(scene: Scene) -> Float[Tensor, ""]:
            positions = scene.mesh.positions
            # L annihilates constants; relative to the centre, float32 keeps the digits of a scene far from the origin
            offsets = laplacian @ (positions - positions.detach().mean(dim=0))
            return (weights * offsets.square().sum(dim=1)).sum()

        return energy


def mesh_laplacian(mesh: Mesh, cotangent: bool = False, scale_free: bool = False) -> tuple[Tensor, Float[Tensor, " V"]]:
    """Sparse L (V V), compressed rows, and a weight for each vertex: the energy is `Σ w |(L V)_i|²`.

    Rows of L are `mean of the neighbours − vertex`, with equal or cotangent weights. `scale_free` chooses the weights
    that make the sum an estimate of `∫ |Δx|² dA` (with equal weights only as far as the triangles are regular). A
    vertex without neighbours, and one whose cotangents sum to nothing, has a row of zeros.
    """
    count = len(mesh.positions)
    edges = mesh.topology.edges
    device, dtype = mesh.positions.device, mesh.positions.dtype
    weights = _cotangents(mesh) if cotangent else torch.ones(len(edges), dtype=torch.float64, device=device)
    both = torch.cat([edges, edges.flip(1)])
    weights = weights.repeat(2)
    total = torch.zeros(count, dtype=torch.float64, device=device).index_add(0, both[:, 0], weights)
    usable = total > 1e-9
    share = torch.where(usable[both[:, 0]], weights / total.clamp_min(1e-9)[both[:, 0]], 0.0)
    diagonal = torch.arange(count, device=device).expand(2, -1)
    rows, columns = torch.cat([both.T, diagonal], dim=1)
    matrix = compressed_sum(rows, columns, torch.cat([share, -usable.double()]).to(dtype), (count, count))
    if not scale_free:
        return matrix, torch.ones(count, dtype=dtype, device=device)
    area = _vertex_areas(mesh)
    mean = area.mean() if count else area.sum()
    if not bool(mean > 0):
        return matrix, torch.zeros(count, dtype=dtype, device=device)
    # Δx = (Σ w_ij (x_j − x_i)) / A with w the half sums of cotangents; on a regular triangulation the umbrella of equal
    # weights is A/(2√3)·Δx. The area of a needle triangle is bounded below, so that its weight stays bounded.
    scale = (total.square() if cotangent else 12.0) / area.clamp_min(0.05 * mean)
    largest = torch.finfo(dtype).max / 1e6
    return matrix, scale.clamp_max(largest).to(dtype)


def _cotangents(mesh: Mesh) -> Float[Tensor, " E"]:
    """Half the sum of the cotangents opposite each edge; clamped to 0, so that no obtuse triangle repels neighbours."""
    topology = mesh.topology
    p = mesh.positions.double()[topology.faces]
    corner = []
    # opposite to edges 01, 12, 20 lie corners 2, 0, 1
    for k in (2, 0, 1):
        u, v = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
        sine = torch.linalg.cross(u, v).norm(dim=1)
        size = u.norm(dim=1) * v.norm(dim=1)
        corner.append((u * v).sum(dim=1) / sine.maximum(1e-3 * size).clamp_min(torch.finfo(torch.float64).tiny))
    corners = torch.cat([topology.faces[:, [0, 1]], topology.faces[:, [1, 2]], topology.faces[:, [2, 0]]])
    values = torch.cat(corner)[corners[:, 0] != corners[:, 1]]
    edge, _ = topology.edge_faces
    total = torch.zeros(len(topology.edges), dtype=torch.float64, device=p.device)
    return (0.5 * total.index_add(0, edge, values)).clamp_min(0)


def _vertex_areas(mesh: Mesh) -> Float[Tensor, " V"]:
    """A third of the area of the triangles around each vertex."""
    p = mesh.positions.double()[mesh.faces]
    area = torch.linalg.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]).norm(dim=1) / 6
    total = torch.zeros(len(mesh.positions), dtype=torch.float64, device=area.device)
    return total.index_add(0, mesh.faces.reshape(-1), area.repeat_interleave(3))
