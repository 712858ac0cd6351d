"""Decisions on held-out views: paired gains in dB, their standard error, and when a gain is significant."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

REQUIRED_STANDARD_ERRORS = 1.0
"""The one-standard-error rule (Breiman et al. 1984), for many held-out views; `critical_value` raises it for few."""
REQUIRED_STANDARD_ERRORS_OF_HYPOTHESES = 1.5
"""Between kinds of material and light. More than one, because several are compared at once. Not more, because gains
differ from view to view where an object has two materials: on a ball that is half gold, half plastic a diffuse model
was 5.9 ± 2.5 dB behind."""
GAP_OF_HYPOTHESES_DB = 3.0
"""About the root mean square distance of a hypothesis from the best one: 2.8 dB on nine captures of the tuning half of
the materials benchmark (docs/studies/model_selection.md#ties-with-a-large-mean-gain)."""
LEAST_EXPECTED_GAIN_DB = 1.0
"""From which a hypothesis is better though its gain may be noise."""
NEAR_TIE_STANDARD_ERRORS = 2.0
"""A smaller margin between the selected hypothesis and the runner-up is a warning."""
MIN_GAIN_DB = 0.1
"""A smaller gain is not worth a more complex model."""
MIN_ERROR_REDUCTION = 0.1 / 255
"""Of the root mean square error in sRGB by a refinement, a tenth of a step of 8 bits: 0.1 dB at 30 dB, 0.6 dB at 45 dB.
So near to the photographs a map explains what a longer fit of the light would explain, too: on a matt ball normals
gained 0.3 dB at 46 dB and cost 1.4 dB on unseen views."""
TRAINING_WEIGHT = 0.368
"""Of the gain on training views beside that on held-out views: that of the .632 estimator (Efron 1983, "Estimating the
error rate of a prediction rule"). Held-out views are few, and may all miss what many photographs show, such as the
reflection of a sun; training views are many, but a model with more freedom is nearer to them in any case."""
SUFFICIENT_DB = 48.1
"""A root mean square error of one step of 8 bits: a closer fit needs no further term."""
SMALLEST_ERROR = 1e-12
"""Mean squared error that counts as 120 dB."""


def paired_gain(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float]:
    """Mean gain in dB over views and the standard error of that mean, from the mean squared errors of each view.

    The difference is taken view by view, so that easy and hard views cancel.
    """
    gains = decibels(after) - decibels(before)
    standard_error = float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else float("inf")
    return float(gains.mean()), standard_error


@lru_cache
def critical_value(standard_errors: float, views: int) -> float:
    """Quantile of Student's t with `views` − 1 degrees of freedom that has the one-sided level of a normal quantile.

    The standard error of few views is uncertain itself: with 3 views one standard error becomes 1.32, two become 4.53.
    Infinite for one view.
    """
    from scipy.stats import norm, t

    return float(t.ppf(norm.cdf(standard_errors), views - 1)) if views > 1 else float("inf")


def is_significant(
    gain: float, standard_error: float, views: int, standard_errors: float = REQUIRED_STANDARD_ERRORS
) -> bool:
    """Whether a mean gain over so many views exceeds its error and `MIN_GAIN_DB`."""
    return gain > MIN_GAIN_DB and gain > critical_value(standard_errors, views) * standard_error


def is_refined(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    standard_errors: float = REQUIRED_STANDARD_ERRORS,
) -> bool:
    """Whether a refinement lowers the mean squared errors of views: by a significant gain, and by an error that a
    photograph of 8 bits can show.
    """
    reduction = float((np.sqrt(before) - np.sqrt(after)).mean())
    gain, standard_error = paired_gain(before, after)
    return reduction > MIN_ERROR_REDUCTION and is_significant(gain, standard_error, len(after), standard_errors)


def is_near_tie(margin: float, standard_error: float, views: int) -> bool:
    """Whether a margin may be noise."""
    return not is_significant(margin, standard_error, views, NEAR_TIE_STANDARD_ERRORS)


def is_within_noise(gain: float, standard_error: float, views: int) -> bool:
    """Whether a gain, of either sign, may be none: the decision that rests on it is a near tie."""
    return bool(abs(gain) <= critical_value(NEAR_TIE_STANDARD_ERRORS, views) * standard_error)


def differs(gain: float, standard_error: float, views: int) -> bool:
    """Whether a gain of one hypothesis over another is more than noise."""
    return is_significant(gain, standard_error, views, REQUIRED_STANDARD_ERRORS_OF_HYPOTHESES)


def is_better_hypothesis(gain: float, standard_error: float, views: int) -> bool:
    """Whether a hypothesis is selected over a simpler one: it differs, or its expected gain is large.

    Where an object has two materials, or a lamp is near, gains differ much from view to view, and the mean of six views
    is uncertain. With a large mean gain the simpler hypothesis is still the worse choice, most probably.
    """
    return differs(gain, standard_error, views) or expected_gain(gain, standard_error) >= LEAST_EXPECTED_GAIN_DB


def is_expected_to_be_better(held_out: tuple[float, float], training: tuple[float, float]) -> bool:
    """Whether a large gain is expected of held-out and training views together: for each, a gain and its error."""
    (gain, standard_error), weight = held_out, TRAINING_WEIGHT
    together = (1 - weight) * gain + weight * training[0]
    noise = float(np.hypot((1 - weight) * standard_error, weight * training[1]))
    return expected_gain(together, noise) >= LEAST_EXPECTED_GAIN_DB


def expected_gain(gain: float, standard_error: float) -> float:
    """The measured gain in dB, drawn to 0 by its noise: the mean of the posterior where true gains are normally
    distributed around 0 with a standard deviation of `GAP_OF_HYPOTHESES_DB`.
    """
    return gain / (1 + (standard_error / GAP_OF_HYPOTHESES_DB) ** 2)


def decibels(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """PSNR of mean squared errors of values in 0…1; at most 120."""
    return np.asarray(-10 * np.log10(np.maximum(errors, SMALLEST_ERROR)))


def mean_decibels(errors: NDArray[np.float64]) -> float:
    """Mean PSNR over views."""
    return float(decibels(errors).mean())
