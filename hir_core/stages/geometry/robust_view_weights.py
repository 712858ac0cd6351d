"""Which masks to believe: a view that disagrees far more than the rest is heard less."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOLERANCE = 3.0
"""A view's error may be this multiple of the median before it loses weight."""

FLOOR = 0.01
"""An error of one hundredth of the silhouette is never suspicious."""


class ViewTrust:
    """Weights from each view's latest error (1 − IoU): 1 up to `TOLERANCE` medians, then falling with the square."""

    def __init__(self, views: int) -> None:
        self._errors = np.full(views, np.nan)
        self._settled = False

    def update(self, views: list[int], errors: NDArray[np.float64], settled: bool) -> NDArray[np.float64]:
        """Notes the errors of a batch and returns its weights; all 1 until the fit has `settled`, when misfits mean
        something.
        """
        self._errors[views] = errors
        self._settled = settled
        return self._weights()[views]

    def distrusted(self) -> dict[int, float]:
        """Views whose weight is below a half."""
        weights = self._weights()
        return {int(i): float(weights[i]) for i in np.flatnonzero(weights < 0.5)}

    def state(self) -> dict[str, NDArray[Any]]:
        """For a checkpoint."""
        return {"errors": self._errors.copy(), "settled": np.asarray(self._settled)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """From a checkpoint."""
        self._errors, self._settled = np.array(state["errors"]), bool(state["settled"])

    def _weights(self) -> NDArray[np.float64]:
        known = self._errors[np.isfinite(self._errors)]
        weights = np.ones(len(self._errors))
        # of fewer than five views none can be said to be the odd one out
        if not self._settled or len(known) < 5:
            return weights
        limit = TOLERANCE * max(float(np.median(known)), FLOOR)
        error = np.where(np.isfinite(self._errors), self._errors, 0.0)
        return np.where(error > limit, (limit / np.maximum(error, limit)) ** 2, 1.0)
