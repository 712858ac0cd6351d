"""First exposures of photographs: from colours of the same places of the surface, before light and material are known.

The logarithm of a pixel's colour is the sum of one value for each place and one for its photograph, but for reflections
that move over the surface; these count little (iteratively reweighted least squares, Holland & Welsch 1977). What all
places of a photograph have in common is not its exposure alone: a metal shows another part of the light to each camera.
That part changes smoothly from camera to camera, and exposures do not. A Gaussian process separates both (Rasmussen &
Williams 2006, section 2.2), with the most likely variances. Exposures that change smoothly are left to the fit.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface

DARKEST = 0.005
"""Linear colours below are noise and shadow, whose logarithms say little about exposures."""
HALF_WEIGHT_DIFFERENCE = 0.05
"""Difference in logarithms at which a pixel has half of its weight (Cauchy)."""
ITERATIONS = 10
"""Of the weights; each solves places and photographs exactly."""
CORRELATION_DEGREES = 45.0
"""Angle between two cameras at which their reflections have a correlation of exp(−½)."""
DEVIATION_RATIOS = (0.0, *np.geomspace(0.1, 30, 24))
"""Standard deviation of reflections over that of exposures, of which the most likely one is taken."""

Array = NDArray[np.float64]


def initial_exposures(surface: Surface, observed: ObservedPixels, eyes: Array) -> Float[Tensor, "views 3"]:
    """Logarithms of brightness and white balance of each view, with a mean of 0; 0 for a view without pixels.

    `eyes`: the centre of each view's camera, (views, 3).
    """
    views = len(eyes)
    color = observed.color.double().cpu().numpy()
    known = ~observed.saturated.cpu().numpy() & (color > DARKEST)
    nearest = observed.points.barycentric.argmax(dim=1, keepdim=True)
    place = surface.faces[observed.points.face].gather(1, nearest)[:, 0].cpu().numpy()
    view = observed.points.view.cpu().numpy()
    found = np.zeros((views, 3))
    for channel in range(3):
        rows = known[:, channel]
        found[:, channel] = _of_views(np.log(color[rows, channel]), place[rows], view[rows], views)
    seen = np.bincount(view, minlength=views) > 0
    toward = eyes[seen] - surface.positions.double().cpu().numpy().mean(axis=0)
    found[seen] = without_reflections(found[seen], toward)
    return torch.from_numpy(found).to(observed.color)


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
