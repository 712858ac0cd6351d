"""Exposures of photographs beside each other, from the colours of the same places of a surface.

The logarithm of a colour is the sum of one value for each place and one for its photograph, but for reflections that
move over the surface; these count little (iteratively reweighted least squares, Holland & Welsch 1977). What all places
of a photograph have in common is not its exposure alone: a metal shows another part of the light to each camera. That
part changes smoothly from camera to camera, and exposures do not. A Gaussian process separates both (Rasmussen &
Williams 2006, section 2.2), with the most likely variances. Exposures that change smoothly are not found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

DARKEST = 0.005
"""Linear colours below are noise and shadow, whose logarithms say little about exposures."""
HALF_WEIGHT_DIFFERENCE = 0.05
"""Difference in logarithms at which a colour has half of its weight (Cauchy)."""
ITERATIONS = 10
"""Of the weights; each solves places and photographs exactly."""
CORRELATION_DEGREES = 45.0
"""Angle between two cameras at which their reflections have a correlation of exp(−½)."""
DEVIATION_RATIOS = (0.0, *np.geomspace(0.1, 30, 24))
"""Standard deviation of reflections over that of exposures, of which the most likely one is taken."""

LEAST_DIFFERENCE = 0.2
"""Standard deviation of logarithms over views, of the channel where it is largest, below which photographs count as
equal: 0.3 stops. Unchanged ones seem to differ by up to 0.12 (docs/studies/exposures.md#before-the-material-is-known).
"""

Array = NDArray[np.float64]


def relative_exposures(
    color: Float[NDArray[np.floating], "N 3"],
    known: Bool[NDArray[np.bool_], "N 3"],
    place: Int[NDArray[np.int64], " N"],
    view: Int[NDArray[np.int64], " N"],
    toward: Float[NDArray[np.floating], "views 3"],
) -> Float[Array, "views 3"]:
    """Logarithms of brightness and white balance of each view, with a mean of 0; 0 for a view without colours.

    `color` is linear and `known` where it is not clipped; values below `DARKEST` are left out. Numbers of places are
    arbitrary. `toward`: from the object to each camera.
    """
    views = len(toward)
    found = np.zeros((views, 3))
    known = known & (color > DARKEST) & np.isfinite(color)
    for channel in range(3):
        rows = known[:, channel]
        logarithms = np.log(color[rows, channel].astype(np.float64))
        found[:, channel] = _of_views(logarithms, place[rows], view[rows], views)
    seen = np.bincount(view, minlength=views) > 0
    found[seen] = without_reflections(found[seen], np.asarray(toward[seen], np.float64))
    return found


def corrections_of_takes(
    color: Float[NDArray[np.floating], "V P 3"],
    known: Bool[NDArray[np.bool_], "V P 3"],
    toward: Float[NDArray[np.floating], "V 3"],
    takes: Sequence[int],
) -> Float[Array, "V 3"] | None:
    """Factors that make the photographs of each take equally exposed, from linear colours of P points in V views; None
    where all are equal already. `takes` has the number of each view's take, `toward` is as in `relative_exposures`.
    """
    found = np.zeros((len(color), 3))
    for take in sorted(set(takes)):
        own = np.flatnonzero(np.asarray(takes) == take)
        view, place = np.nonzero(known[own].any(axis=2))
        rows = own[view], place
        found[own] = relative_exposures(color[rows], known[rows], place, view, np.asarray(toward)[own])
    if len(found) < 2 or found.std(axis=0).max() < LEAST_DIFFERENCE:
        return None
    return np.exp(-found)


def without_reflections_of_takes(
    logarithms: Float[Array, "V C"], toward: Float[NDArray[np.floating], "V 3"], takes: Sequence[int]
) -> Float[Array, "V C"]:
    """`without_reflections` of the views of each take, which has a light of its own."""
    found = np.zeros_like(logarithms)
    for take in sorted(set(takes)):
        own = np.flatnonzero(np.asarray(takes) == take)
        found[own] = without_reflections(logarithms[own], np.asarray(toward[own], np.float64))
    return found


def without_reflections(common: Array, toward: Array) -> Array:
    """The part of values (views, channels) that differs at random between views; `toward`: directions to cameras."""
    if len(common) < 2:
        return common
    toward = toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    angle = np.arccos(np.clip(toward @ toward.T, -1, 1))
    kernel = np.exp(-0.5 * np.square(angle / np.radians(CORRELATION_DEGREES)))
    # without the mean of the views, which belongs to the light
    center = np.eye(len(common)) - 1 / len(common)
    variance, basis = np.linalg.eigh(center @ kernel @ center)
    parts = basis.T @ (common - common.mean(axis=0))
    free = np.abs(basis.sum(axis=0)) < 0.5 * np.sqrt(len(common))
    variance, parts, basis = np.maximum(variance[free], 0), parts[free], basis[:, free]

    def minus_log_likelihood(ratio: float) -> float:
        scale = 1 + ratio**2 * variance[:, None]
        # the variance of exposures that is most likely for this ratio
        exposures = max(float((parts**2 / scale).mean()), 1e-12)
        return float(np.log(scale).mean() + np.log(exposures))

    best = min(DEVIATION_RATIOS, key=minus_log_likelihood)
    return np.asarray(basis @ (parts / (1 + best**2 * variance[:, None])))


def _of_views(values: Array, place: NDArray[np.int64], view: NDArray[np.int64], views: int) -> Array:
    """The values of views, where `values` are those of places and views together."""
    found, weight = np.zeros(views), np.ones(len(values))
    if len(values) == 0:
        return found
    _, place = np.unique(place, return_inverse=True)
    for _ in range(ITERATIONS):
        found, of_place = _solved(values, weight, place, view, views)
        difference = values - of_place[place] - found[view]
        weight = 1 / (1 + np.square(difference / HALF_WEIGHT_DIFFERENCE))
    return found


def _solved(
    values: Array, weight: Array, place: NDArray[np.int64], view: NDArray[np.int64], views: int
) -> tuple[Array, Array]:
    """Weighted least squares; the values of places are eliminated. Of views that share no place with others each group
    has a mean of 0.
    """
    from scipy.sparse import coo_array

    total = np.bincount(place, weight)
    shared = coo_array((weight, (place, view)), shape=(len(total), views)).tocsr()
    mean_of_place = np.bincount(place, weight * values) / total
    share = shared.multiply(1 / total[:, None]).tocsr()
    laplacian = np.diag(np.bincount(view, weight, views)) - (shared.T @ share).toarray()
    right = np.bincount(view, weight * values, views) - shared.T @ mean_of_place
    found = np.linalg.lstsq(laplacian, right, rcond=1e-9)[0]
    return found, mean_of_place - share @ found
