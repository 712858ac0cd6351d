"""The part of the masks that a fitted mesh does not explain: missing parts and filled gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh
from hir_core.scene.silhouette_targets import SilhouetteTargets

OUTLINE_MARGIN_PIXELS = 2
"""Pixels on both sides of the outline that do not count: there the outline is only inexact."""

VIEWS_MAX = 40
"""At most this many views are rendered, evenly spaced."""


@dataclass(frozen=True)
class SilhouetteResidual:
    """Means over the views, as shares of the mask's area, and the worst view of each kind."""

    missing: float
    """Inside the mask, more than `OUTLINE_MARGIN_PIXELS` from the silhouette: thin parts that the mesh has lost."""
    filled: float
    """Inside the silhouette, more than `OUTLINE_MARGIN_PIXELS` from the mask: gaps that the mesh has closed."""
    worst_missing: tuple[int, float]
    """View and its share; (−1, 0) without views."""
    worst_filled: tuple[int, float]


@torch.no_grad()
def silhouette_residual(
    renderer: GeometryRenderer, mesh: Mesh, targets: SilhouetteTargets, views: Sequence[int]
) -> SilhouetteResidual:
    """Compares rendered coverage with the masks of the named views, of an even choice where there are many."""
    step = max(1, -(-len(views) // VIEWS_MAX))
    missing: dict[int, float] = {}
    filled: dict[int, float] = {}
    for view in views[::step]:
        mask = targets.masks[view].to(mesh.positions.device) > 0.5
        silhouette = renderer.render(mesh, [targets.cameras[view]])[0, : mask.shape[0], : mask.shape[1]] > 0.5
        area = max(1.0, float(mask.sum()))
        missing[view] = float((mask & ~_dilated(silhouette)).sum()) / area
        filled[view] = float((silhouette & ~_dilated(mask)).sum()) / area
    if not missing:
        return SilhouetteResidual(0.0, 0.0, (-1, 0.0), (-1, 0.0))
    worst = [max(shares.items(), key=lambda item: item[1]) for shares in (missing, filled)]
    return SilhouetteResidual(
        sum(missing.values()) / len(missing), sum(filled.values()) / len(filled), worst[0], worst[1]
    )


def _dilated(mask: Tensor) -> Tensor:
    side = 2 * OUTLINE_MARGIN_PIXELS + 1
    return max_pool2d(mask[None, None].float(), side, 1, OUTLINE_MARGIN_PIXELS)[0, 0] > 0
