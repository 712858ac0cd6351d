"""What a fitted mesh could not explain of the masks: parts that are missing, and gaps that are filled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh
from hir_core.scene.silhouette_targets import SilhouetteTargets

MARGIN = 2
"""Pixels about the outline that are none of this check's business: there the outline is merely inexact."""

VIEWS = 40
"""At most this many views are rendered for the check."""

NOTABLE = 1e-3
"""Share of a mask from which a missing part is worth a sentence."""


@dataclass(frozen=True)
class Residue:
    """Means over views, as shares of the mask's area, and the view that is worst in each."""

    missing: float
    """Inside the mask, farther than `MARGIN` from the silhouette: thin parts that the mesh has lost."""
    filled: float
    """Inside the silhouette, farther than `MARGIN` from the mask: gaps that the mesh has closed."""
    worst_missing: tuple[int, float]
    worst_filled: tuple[int, float]


@torch.no_grad()
def mask_residue(renderer: GeometryRenderer, mesh: Mesh, targets: SilhouetteTargets, views: Sequence[int]) -> Residue:
    """Compares rendered coverage with the masks of (an even choice of) the views named."""
    step = max(1, -(-len(views) // VIEWS))
    missing: dict[int, float] = {}
    filled: dict[int, float] = {}
    for view in views[::step]:
        mask = targets.masks[view].to(mesh.positions.device) > 0.5
        silhouette = renderer.render(mesh, [targets.cameras[view]])[0, : mask.shape[0], : mask.shape[1]] > 0.5
        area = max(1.0, float(mask.sum()))
        missing[view] = float((mask & ~_grown(silhouette)).sum()) / area
        filled[view] = float((silhouette & ~_grown(mask)).sum()) / area
    if not missing:
        return Residue(0.0, 0.0, (-1, 0.0), (-1, 0.0))
    worst = [max(found.items(), key=lambda item: item[1]) for found in (missing, filled)]
    return Residue(sum(missing.values()) / len(missing), sum(filled.values()) / len(filled), worst[0], worst[1])


def _grown(mask: Tensor) -> Tensor:
    return max_pool2d(mask[None, None].float(), 2 * MARGIN + 1, 1, MARGIN)[0, 0] > 0
