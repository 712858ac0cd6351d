"""Whether fitted exposures follow those that the photographs record: if not, the camera's response is not that of sRGB.

The linear values of a photograph with a response x^γ instead of sRGB's are a power of the radiance, to first order.
Fitted exposures are then the same power of the recorded ones, and a line through their logarithms has it as its slope.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hir_core.capture import View
from hir_core.capture.photograph_exposures import Factors, recorded_exposure

MIN_STOPS = 1.0
"""From the shortest to the longest recorded exposure; a smaller range shows little of a response."""
MIN_PHOTOGRAPHS = 6
MIN_DIFFERENCE = 0.1
"""Of the exponent from 1, below which nothing is said: it is 0.1 stops over one stop."""
CONFIDENCE = 0.99


@dataclass(frozen=True)
class ResponseReport:
    """The power of the recorded exposures that the fitted ones are."""

    exponent: float
    """1 for a response of sRGB."""
    standard_error: float
    recorded_stops: float
    """From the shortest to the longest recorded exposure of a take."""
    differs: bool
    """Whether the exponent is not 1, by more than noise and by more than `MIN_DIFFERENCE`."""
    sentence: str
    """All of it in words."""


def camera_response(fitted: Mapping[str, Factors], views: Sequence[View]) -> ResponseReport | None:
    """`fitted`: factors by name of the photograph, beside its own gain; of several takes those within each count.

    None where too few photographs record exposures, or where these are too much alike.
    """
    pairs = [
        (view.take, np.log2(recorded), np.log2(fitted[view.name] * view.gain).mean())
        for view in views
        if view.name in fitted and (recorded := recorded_exposure(view))
    ]
    takes = {take for take, _, _ in pairs}
    free = len(pairs) - len(takes) - 1
    if len(pairs) < MIN_PHOTOGRAPHS or free < 1:
        return None
    x, y = np.zeros(0), np.zeros(0)
    stops = 0.0
    for take in sorted(takes):
        # how bright one take is beside another is part of their lights
        recorded, factor = np.array([(a, b) for own, a, b in pairs if own == take], dtype=np.float64).T
        x, y = np.append(x, recorded - recorded.mean()), np.append(y, factor - factor.mean())
        stops = max(stops, float(np.ptp(recorded)))
    if stops < MIN_STOPS:
        return None
    from scipy.special import stdtrit

    square = float(x @ x)
    exponent = float(x @ y) / square
    residual = y - exponent * x
    error = float(np.sqrt(residual @ residual / free / square))
    limit = max(MIN_DIFFERENCE, float(stdtrit(free, 0.5 + CONFIDENCE / 2)) * error)
    differs = abs(exponent - 1) > limit
    sentence = (
        f"the brightness of the photographs follows their recorded exposures to the power of {exponent:.2f} ± "
        f"{error:.2f}, over {stops:.1f} stops"
    )
    return ResponseReport(round(exponent, 4), round(error, 4), round(stops, 3), differs, sentence)


def response_warning(report: ResponseReport | None) -> str | None:
    """One sentence where the response differs from that of sRGB."""
    if report is None or not report.differs:
        return None
    return (
        f"{report.sentence}: the camera's response is not that of sRGB, so dark and bright parts of the material are "
        "wrong; turn off HDR, tone curves and picture styles, or give raw files, or lock the exposure"
    )
