"""Decisions on held-out views: paired gains in dB and their standard error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

REQUIRED_STANDARD_ERRORS = 1.0
"""The one-standard-error rule (Breiman et al. 1984). With few held-out views a stricter rule rejects models that unseen
views gain from (chair: a specular lobe that gains 0.36 dB there, and 0.25 ± 0.21 dB on six held-out views)."""
SMALLEST_ERROR = 1e-12
"""Mean squared error that counts as 120 dB."""


def paired_gain(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float]:
    """Mean gain in dB over views and the standard error of that mean, from the mean squared errors of each view.

    The difference is taken view by view, so that easy and hard views cancel.
    """
    gains = decibels(after) - decibels(before)
    standard_error = float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else float("inf")
    return float(gains.mean()), standard_error


def decibels(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """PSNR of mean squared errors of values in 0…1; at most 120."""
    return np.asarray(-10 * np.log10(np.maximum(errors, SMALLEST_ERROR)))


def mean_decibels(errors: NDArray[np.float64]) -> float:
    """Mean PSNR over views."""
    return float(decibels(errors).mean())
