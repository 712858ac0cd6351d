"""Whether refined cameras explain the masks of views that took no part in the refinement better than given ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hir_core.capture import Array
from hir_plugins.initializers.refinement.cross_hulls import HullBox, hull_box, hulls_of
from hir_plugins.initializers.refinement.outline_points import outline_points
from hir_plugins.initializers.refinement.silhouette_agreement import compared_with_hull
from hir_plugins.initializers.refinement.silhouette_poses import moved_to_outlines, refine_poses
from hir_plugins.initializers.surface.isosurface import Faces
from hir_plugins.initializers.surface.silhouette_fields import SilhouetteField, focus_and_radius

_INTERVAL = 4
"""Every fourth view is held out."""
_FOLDS = (0, 2)
"""Held out one after the other: half of the views are compared, each with hulls of three quarters."""
_ROUNDS = 4
"""At most, of the refinement, and of fitting the pose of a held-out view to a hull."""
_MIN_GAIN = 0.003
"""Least mean gain in IoU that counts."""
_STANDARD_ERRORS = 2.0


@dataclass(frozen=True)
class HeldOutAgreement:
    """IoU of each held-out mask (H,) and the hull of the other views' masks."""

    before: Array
    """With the given cameras."""
    after: Array
    """With refined cameras."""

    @property
    def better(self) -> bool:
        """Whether the mean gain is more than two standard errors of the paired differences, and not negligible."""
        gain = self.after - self.before
        error = float(gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else np.inf
        return float(gain.mean()) > max(_MIN_GAIN, _STANDARD_ERRORS * error)


def held_out_agreement(fields: Sequence[SilhouetteField], rounds: int) -> HeldOutAgreement:
    """Refines three quarters of the views, and compares the others with the hull of these before and after.

    The pose of a held-out view is fitted to either hull: what differs is the hull alone.
    """
    before, after = [], []
    for first in _FOLDS:
        held_out = [field for i, field in enumerate(fields) if i % _INTERVAL == first]
        others = [field for i, field in enumerate(fields) if i % _INTERVAL != first]
        box = hull_box(others)
        before.append(_fitted_agreement(held_out, _hull(others, box)))
        after.append(_fitted_agreement(held_out, _hull(refine_poses(others, min(rounds, _ROUNDS)), box)))
    return HeldOutAgreement(np.concatenate(before), np.concatenate(after))


def _hull(fields: Sequence[SilhouetteField], box: HullBox) -> tuple[Array, Faces]:
    return hulls_of(fields, [np.arange(len(fields))], box)[0]


def _fitted_agreement(fields: Sequence[SilhouetteField], hull: tuple[Array, Faces]) -> Array:
    focus, _ = focus_and_radius(fields)
    given, current = [field.camera for field in fields], list(fields)
    for _ in range(_ROUNDS):
        points = outline_points(*hull, [field.camera for field in current])
        current = moved_to_outlines(current, given, points, focus)
    return compared_with_hull(hull, current)[0]
