"""How well each mask agrees with the visual hull of other masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hir_core.capture import Array
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets, intersection_over_union
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from hir_plugins.initializers.refinement.cross_hulls import HullBox, fold_of_views, hull_box, hulls_of_others
from hir_plugins.initializers.surface.isosurface import Faces
from hir_plugins.initializers.surface.silhouette_fields import SilhouetteField


@dataclass(frozen=True)
class SilhouetteAgreement:
    """Each mask compared with the silhouette of the hull of other masks."""

    iou: Array
    """(V,)"""
    uncovered: Array
    """(V,): share of the mask beside the silhouette. Of right cameras it is near 0: the hull contains the object."""
    gap: Array
    """(V,): area of the mask beside the silhouette over the length of the mask's outline, in pixels of the mask."""


def silhouette_agreement(fields: Sequence[SilhouetteField], box: HullBox | None = None) -> SilhouetteAgreement:
    """The agreement of each view; `CaptureError` where no point is in all masks."""
    fold = fold_of_views(len(fields))
    iou, uncovered = np.zeros(len(fields)), np.ones(len(fields))
    for each, hull in enumerate(hulls_of_others(fields, hull_box(fields) if box is None else box)):
        own = np.flatnonzero(fold == each).tolist()
        iou[own], uncovered[own] = compared_with_hull(hull, [fields[i] for i in own])
    area = np.array([np.count_nonzero(field.distance > 0) for field in fields])
    length = np.array([np.count_nonzero(np.abs(field.distance) < 0.5) for field in fields])
    return SilhouetteAgreement(iou, uncovered, uncovered * area / np.maximum(length, 1))


def compared_with_hull(hull: tuple[Array, Faces], fields: Sequence[SilhouetteField]) -> tuple[Array, Array]:
    """IoU of each mask (V,) and the silhouette of a hull, and the share of the mask beside it."""
    positions, faces = hull
    mesh = Mesh(torch.from_numpy(positions), Topology(torch.from_numpy(faces)))
    # the share of a pixel that is object, where the outline passes at a distance from its centre
    masks = [torch.from_numpy((field.distance.astype(np.float32) + 0.5).clip(0, 1)) for field in fields]
    targets = SilhouetteTargets(tuple(field.camera for field in fields), tuple(masks))
    with torch.no_grad():
        area, overlap = Contour(ContourOptions()).overlap(mesh, targets)
    iou = intersection_over_union(area, overlap, targets.areas)
    return iou.numpy(), (1 - overlap / targets.areas.clamp_min(1e-6)).numpy()
