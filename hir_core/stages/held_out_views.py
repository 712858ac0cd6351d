"""Which training views are held out: for model selection, and for the silhouette fit."""

from __future__ import annotations

from collections.abc import Sequence

HELD_OUT_INTERVAL = 8
"""Every eighth view is held out for model selection."""
MIN_HELD_OUT_VIEWS = 3
"""One view alone has no standard error, so that no candidate could ever be accepted."""
MIN_VIEWS = 6
"""With fewer views none is held out and no models are compared."""
MIN_VIEWS_FOR_GEOMETRY = 10
"""With fewer views the silhouette fit holds none out."""
JUDGING_VIEWS = 6
"""Views that decide how far photo-consistency moves the mesh: of two the standard error itself is unknown."""
JUDGING_SHARE = 1 / 3
"""At most this share of the views decides; the others must still overlap."""


def held_out_for_model_selection(views: int) -> tuple[list[int], list[int]]:
    """Indices of the training views and of the held-out views; none is held out of fewer than `MIN_VIEWS`."""
    every = list(range(views))
    if views < MIN_VIEWS:
        held_out = []
    elif views < MIN_HELD_OUT_VIEWS * HELD_OUT_INTERVAL:
        held_out = [int((i + 0.5) * views / MIN_HELD_OUT_VIEWS) for i in range(MIN_HELD_OUT_VIEWS)]
    else:
        held_out = every[HELD_OUT_INTERVAL // 2 :: HELD_OUT_INTERVAL]
    return [v for v in every if v not in held_out], held_out


def held_out_for_geometry(views: int, share: float) -> list[int]:
    """Indices of a share of the views, spaced evenly over the capture's order; none of fewer than ten views."""
    count = round(views * share) if views >= MIN_VIEWS_FOR_GEOMETRY else 0
    return [int((i + 0.5) * views / count) for i in range(count)]


def judging_views(views: int, held_out: Sequence[int]) -> list[int]:
    """Indices of the views that judge the photo-consistency refinement: `held_out`, and others evenly spaced between
    them up to `JUDGING_VIEWS` or `JUDGING_SHARE` of the views; none where none is held out.
    """
    if not held_out:
        return []
    others = [v for v in range(views) if v not in set(held_out)]
    missing = max(0, min(JUDGING_VIEWS, int(views * JUDGING_SHARE)) - len(held_out))
    added = [others[int((i + 0.5) * len(others) / missing)] for i in range(missing)]
    return sorted([*held_out, *added])
