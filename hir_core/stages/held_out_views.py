"""Which training views are held out: for model selection, and for the silhouette fit.

`takes` has the number of each view's take (`Capture.take_numbers`); without it all views are of one. Of several takes
each leaves at least half of its views to the fit: a take of one photograph is never held out.
"""

from __future__ import annotations

from collections.abc import Sequence

HELD_OUT_INTERVAL = 8
"""At least every eighth view is held out for model selection."""
MIN_HELD_OUT_VIEWS = 6
"""Held-out views of a comparison, where the capture has enough: two or three give no usable standard error."""
MIN_VIEWS = 6
"""With fewer views none is held out and no models are compared."""
MIN_VIEWS_OF_FOLD = 3
"""Held-out views of a fold below which no models are compared; one take has as many where it has `MIN_VIEWS`."""
MIN_VIEWS_FOR_GEOMETRY = 10
"""With fewer views the silhouette fit holds none out."""
JUDGING_VIEWS = 6
"""Views that decide how far photo-consistency moves the mesh: of two the standard error itself is unknown."""
JUDGING_SHARE = 1 / 3
"""At most this share of the views decides; the others must still overlap."""

FOLDS = 2

Fold = tuple[list[int], list[int]]
"""Indices of the training views and of the held-out views."""


def model_selection_folds(views: int, takes: Sequence[int] = ()) -> list[Fold]:
    """Disjoint sets of held-out views, spaced evenly over each take in the capture's order; none with fewer than
    `MIN_VIEWS`, or where the takes are too small to hold out `MIN_VIEWS_OF_FOLD`.

    Half of fewer than twelve views of one take is held out: there every view is held out in one of the two folds.
    """
    if views < MIN_VIEWS:
        return []
    candidates = _candidates(views, takes)
    count = min(len(candidates) // 2, max(MIN_HELD_OUT_VIEWS, views // HELD_OUT_INTERVAL))
    if count < MIN_VIEWS_OF_FOLD:
        return []
    folds = []
    for number in range(FOLDS):
        # offsets that differ by half a stride of two or more views never meet
        held_out = _evenly_spaced(candidates, count, 0.5 if number == 0 else 0.0)
        folds.append(([v for v in range(views) if v not in held_out], held_out))
    return folds


def held_out_for_model_selection(views: int, takes: Sequence[int] = ()) -> Fold:
    """The first fold; all views are training views where none can be held out."""
    folds = model_selection_folds(views, takes)
    return folds[0] if folds else (list(range(views)), [])


def folds_of_a_comparison(folds: Sequence[Fold]) -> range:
    """Numbers of the first folds that together have `MIN_HELD_OUT_VIEWS`; all where these are fewer."""
    count = min(1, len(folds))
    while count < len(folds) and sum(len(held_out) for _, held_out in folds[:count]) < MIN_HELD_OUT_VIEWS:
        count += 1
    return range(count)


def held_out_for_geometry(views: int, share: float, takes: Sequence[int] = ()) -> list[int]:
    """Indices of a share of the views, spaced evenly over each take in the capture's order; none of fewer than ten
    views. Of several takes at most half is held out."""
    candidates = _candidates(views, takes)
    count = round(views * share) if views >= MIN_VIEWS_FOR_GEOMETRY else 0
    return _evenly_spaced(candidates, min(count, _most_held_out(candidates, takes)))


def judging_views(views: int, held_out: Sequence[int], takes: Sequence[int] = ()) -> list[int]:
    """Indices of the views that decide on the photo-consistency refinement: `held_out`, and others evenly spaced
    between them, up to `JUDGING_VIEWS` or `JUDGING_SHARE` of the views; none where none is held out.
    """
    if not held_out:
        return []
    others = _candidates(views, takes, held_out)
    missing = max(0, min(JUDGING_VIEWS, int(views * JUDGING_SHARE)) - len(held_out))
    return sorted([*held_out, *_evenly_spaced(others, min(missing, _most_held_out(others, takes)))])


def _candidates(views: int, takes: Sequence[int], held_out: Sequence[int] = ()) -> list[int]:
    """The views that may be held out besides `held_out`, take by take.

    Of several takes, each has twice as many candidates as it may hold out. At most every second candidate is held out,
    evenly spaced, so that no take exceeds its half.
    """
    others = [v for v in range(views) if v not in set(held_out)]
    if len(set(takes)) <= 1:
        return others
    candidates: list[int] = []
    for take in dict.fromkeys(takes):
        members = [v for v in others if takes[v] == take]
        allowed = takes.count(take) // 2 - sum(takes[v] == take for v in held_out)
        candidates += _evenly_spaced(members, 2 * max(0, allowed))
    return candidates


def _most_held_out(candidates: Sequence[int], takes: Sequence[int]) -> int:
    """Of one take the caller's share alone decides."""
    return len(candidates) if len(set(takes)) <= 1 else len(candidates) // 2


def _evenly_spaced(candidates: Sequence[int], count: int, offset: float = 0.5) -> list[int]:
    return [candidates[int((i + offset) * len(candidates) / count)] for i in range(count)]
