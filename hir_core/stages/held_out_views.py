"""Which training views are held out: for model selection, and for the silhouette fit."""

from __future__ import annotations

from collections.abc import Sequence

HELD_OUT_INTERVAL = 8
"""At least every eighth view is held out for model selection."""
MIN_HELD_OUT_VIEWS = 6
"""Held-out views of a comparison, where the capture has enough: two or three give no usable standard error."""
MIN_VIEWS = 6
"""With fewer views none is held out and no models are compared."""
MIN_VIEWS_FOR_GEOMETRY = 10
"""With fewer views the silhouette fit holds none out."""
JUDGING_VIEWS = 6
"""Views that decide how far photo-consistency moves the mesh: of two the standard error itself is unknown."""
JUDGING_SHARE = 1 / 3
"""At most this share of the views decides; the others must still overlap."""

FOLDS = 2

Fold = tuple[list[int], list[int]]
"""Indices of the training views and of the held-out views."""


def model_selection_folds(views: int) -> list[Fold]:
    """Disjoint sets of held-out views, spaced evenly over the capture's order; none with fewer than `MIN_VIEWS`.

    Half of fewer than twelve views is held out: there every view is held out in one of the two folds.
    """
    if views < MIN_VIEWS:
        return []
    count = min(views // 2, max(MIN_HELD_OUT_VIEWS, views // HELD_OUT_INTERVAL))
    folds = []
    for number in range(FOLDS):
        # offsets that differ by half a stride of two or more views never meet
        offset = 0.5 if number == 0 else 0.0
        held_out = [int((i + offset) * views / count) for i in range(count)]
        folds.append(([v for v in range(views) if v not in held_out], held_out))
    return folds


def held_out_for_model_selection(views: int) -> Fold:
    """The first fold; all views are training views where none can be held out."""
    folds = model_selection_folds(views)
    return folds[0] if folds else (list(range(views)), [])


def held_out_for_geometry(views: int, share: float) -> list[int]:
    """Indices of a share of the views, spaced evenly over the capture's order; none of fewer than ten views."""
    count = round(views * share) if views >= MIN_VIEWS_FOR_GEOMETRY else 0
    return [int((i + 0.5) * views / count) for i in range(count)]


def judging_views(views: int, held_out: Sequence[int]) -> list[int]:
    """Indices of the views that decide on the photo-consistency refinement: `held_out`, and others evenly spaced
    between them, up to `JUDGING_VIEWS` or `JUDGING_SHARE` of the views; none where none is held out.
    """
    if not held_out:
        return []
    others = [v for v in range(views) if v not in set(held_out)]
    missing = max(0, min(JUDGING_VIEWS, int(views * JUDGING_SHARE)) - len(held_out))
    added = [others[int((i + 0.5) * len(others) / missing)] for i in range(missing)]
    return sorted([*held_out, *added])
