"""Drops pieces of a start mesh that no mask asks for: phantoms of a visual hull that float in front of or inside the
object.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hir_core.mesh.mesh_validity import component_of_vertices
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets

NEEDED = 2e-4
"""A view needs a piece that covers more than this share of its mask which nothing else covers."""

VIEWS = 40
"""At most this many views are asked."""


@torch.no_grad()
def without_loose_pieces(
    renderer: GeometryRenderer, mesh: Mesh, targets: SilhouetteTargets, views: list[int]
) -> tuple[Mesh, int]:
    """The mesh without its unneeded components, and how many those were. The largest component always stays."""
    faces = mesh.faces.cpu().numpy()
    if len(faces) == 0:
        return mesh, 0
    count, owner = component_of_vertices(faces)
    if count < 2:
        return mesh, 0
    asked = targets[views[:: max(1, -(-len(views) // VIEWS))]]
    piece = owner[faces[:, 0]]
    p = mesh.positions.detach().cpu().numpy().astype(np.float64)[faces]
    size = np.bincount(piece, np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1))
    ascending = np.argsort(size, kind="stable")
    kept = np.ones(count, dtype=bool)
    allowed = (NEEDED * asked.areas).clamp_min(2.0)

    def covered() -> Tensor:
        part = Mesh(mesh.positions, Topology(mesh.faces[torch.from_numpy(kept[piece]).to(mesh.faces.device)]))
        found = [renderer.overlap(part, asked[range(i, min(i + 8, len(asked)))])[1] for i in range(0, len(asked), 8)]
        return torch.cat(found).double().cpu()

    whole = covered()
    # all small pieces at once; where one of them is needed, each half by itself
    waiting = [ascending[:-1]]
    while waiting:
        group = waiting.pop()
        kept[group] = False
        if bool((whole - covered() > allowed).any()):
            kept[group] = True
            if len(group) > 1:
                waiting += [group[len(group) // 2 :], group[: len(group) // 2]]
    if kept.all():
        return mesh, 0
    chosen = faces[kept[piece]]
    used, compact = np.unique(chosen, return_inverse=True)
    device = mesh.positions.device
    index = torch.from_numpy(used).to(device)
    topology = Topology(torch.from_numpy(compact.reshape(-1, 3)).to(device))
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[index]
    return Mesh(mesh.positions[index], topology, vertex_colors=colors), int((~kept).sum())
