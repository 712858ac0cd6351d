"""Removes floating components of the initial mesh: pieces that no mask needs, such as phantoms of a visual hull."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hir_core.mesh.mesh_validity import component_of_vertices
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets

NEEDED_MASK_SHARE = 2e-4
"""A view needs a component that covers more than this share of its mask which no other component covers."""

VIEWS_MAX = 40
"""At most this many views are tested, evenly spaced."""

VIEWS_PER_BATCH = 8


@torch.no_grad()
def remove_floating_components(
    renderer: GeometryRenderer, mesh: Mesh, targets: SilhouetteTargets, views: list[int]
) -> tuple[Mesh, int]:
    """The mesh without the components that no view needs, and how many were removed. The largest one always stays."""
    faces = mesh.faces.cpu().numpy()
    if len(faces) == 0:
        return mesh, 0
    count, component_of_vertex = component_of_vertices(faces)
    if count < 2:
        return mesh, 0
    tested = targets[views[:: max(1, -(-len(views) // VIEWS_MAX))]]
    component = component_of_vertex[faces[:, 0]]
    p = mesh.positions.detach().cpu().numpy().astype(np.float64)[faces]
    area = np.bincount(component, np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1))
    ascending = np.argsort(area, kind="stable")
    needed = np.ones(count, dtype=bool)
    tolerance = (NEEDED_MASK_SHARE * tested.areas).clamp_min(2.0)

    def covered() -> Tensor:
        part = Mesh(mesh.positions, Topology(mesh.faces[torch.from_numpy(needed[component]).to(mesh.faces.device)]))
        batches = [range(i, min(i + VIEWS_PER_BATCH, len(tested))) for i in range(0, len(tested), VIEWS_PER_BATCH)]
        return torch.cat([renderer.overlap(part, tested[batch])[1] for batch in batches]).double().cpu()

    whole = covered()
    # bisection: all small components at once; where one of them is needed, each half by itself
    queue = [ascending[:-1]]
    while queue:
        group = queue.pop()
        needed[group] = False
        if bool((whole - covered() > tolerance).any()):
            needed[group] = True
            if len(group) > 1:
                queue += [group[len(group) // 2 :], group[: len(group) // 2]]
    if needed.all():
        return mesh, 0
    chosen = faces[needed[component]]
    used, compact = np.unique(chosen, return_inverse=True)
    device = mesh.positions.device
    index = torch.from_numpy(used).to(device)
    topology = Topology(torch.from_numpy(compact.reshape(-1, 3)).to(device))
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[index]
    return Mesh(mesh.positions[index], topology, vertex_colors=colors), int((~needed).sum())
