"""Robust weights of views: a view whose mask contradicts the others counts less."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hir_core.optimization.checkpoints import Arrays

OUTLIER_MEDIANS = 3.0
"""A view's error may be this multiple of the median error before it loses weight."""

LEAST_MEDIAN_ERROR = 0.01
"""The median counts as at least this 1 − IoU: an error of one hundredth of the silhouette is never an outlier."""

LEAST_VIEWS = 5
"""Fewer views do not tell which of them is the outlier."""


class RobustViewWeights:
    """Weights from each view's latest error (1 − IoU).

    The weight is 1 up to `OUTLIER_MEDIANS` medians and falls with the square of the error beyond.
    """

    def __init__(self, views: int) -> None:
        self._errors = np.full(views, np.nan)
        self._active = False

    def update(self, views: list[int], errors: NDArray[np.float64], active: bool) -> NDArray[np.float64]:
        """Stores the errors of a batch of views and returns their weights.

        All weights are 1 until `active`: early in a fit a large error means that the mesh is wrong, not the mask.
        """
        self._errors[views] = errors
        self._active = active
        return self._weights()[views]

    def down_weighted(self) -> dict[int, float]:
        """Views whose weight is below one half, with their weight."""
        weights = self._weights()
        return {int(i): float(weights[i]) for i in np.flatnonzero(weights < 0.5)}

    def state(self) -> Arrays:
        """For a checkpoint."""
        return {"errors": self._errors.copy(), "active": np.asarray(self._active)}

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """From a checkpoint."""
        self._errors, self._active = np.array(state["errors"], dtype=np.float64), bool(state["active"])

    def _weights(self) -> NDArray[np.float64]:
        known = self._errors[np.isfinite(self._errors)]
        weights = np.ones(len(self._errors))
        if not self._active or len(known) < LEAST_VIEWS:
            return weights
        limit = OUTLIER_MEDIANS * max(float(np.median(known)), LEAST_MEDIAN_ERROR)
        error = np.where(np.isfinite(self._errors), self._errors, 0.0)
        return np.where(error > limit, (limit / np.maximum(error, limit)) ** 2, 1.0)
