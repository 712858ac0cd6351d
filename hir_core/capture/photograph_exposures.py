"""Exposures of photographs beside each other: recorded by EXIF data, or fitted, and applied to a capture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.capture import Capture, View
from hir_core.capture.exif import camera_record
from hir_core.errors import CaptureError

Exposures: TypeAlias = Literal["equal", "recorded", "fitted"]
"""Brightness of the photographs beside each other: all are equal; `View.recorded_exposure`; or a brightness and a white
balance of each are fitted. A photograph that was not fitted is then compared at the factors that suit it best."""

LEAST_RECORDED_RATIO = 1.02
"""Of the longest to the shortest recorded exposure: below, all count as equal."""

Factors = tuple[float, float, float]


@dataclass(frozen=True)
class PhotographExposures:
    """The exposures that a fit used."""

    kind: Exposures = "equal"
    factors: Mapping[str, Factors] = field(default_factory=dict)
    """By name of the view, beside its own `gain`; empty for `equal`. Their geometric mean is 1."""
    reference: float | None = None
    """Recorded exposure whose factor is 1; only for `recorded`."""

    def applied_to(self, capture: Capture) -> Capture:
        """The capture, with the factors of the views that the fit used (of the train split), or that they record."""
        known = self.factors if capture.split == "train" else {}
        return replace(capture, views=tuple(self._applied(view, known.get(view.name)) for view in capture.views))

    def _applied(self, view: View, factors: Factors | None) -> View:
        if factors is None and self.reference is not None:
            recorded = recorded_exposure(view)
            factors = None if recorded is None else (recorded / self.reference,) * 3
        if factors is None:
            return view
        red, green, blue = (old * new for old, new in zip(view.white_balance, factors, strict=True))
        return replace(view, white_balance=(red, green, blue))

    @classmethod
    def of(cls, kind: Exposures, capture: Capture, factors: NDArray[np.float32] | None) -> PhotographExposures:
        """The exposures of a fit to all views of a capture; factors are (views, 3)."""
        if kind == "equal" or factors is None:
            return cls()
        rows = [tuple(float(each) for each in row) for row in factors.astype(np.float64).tolist()]
        named = {view.name: row for view, row in zip(capture.views, rows, strict=True)}
        return cls(kind, named, _mean_recorded(capture) if kind == "recorded" else None)  # type: ignore[arg-type]

    def as_document(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "kind": self.kind,
            "factors": {n: list(f) for n, f in self.factors.items()},
            "reference": self.reference,
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> PhotographExposures:
        """The inverse of `as_document`; `ValueError` where it is malformed."""
        kind, factors, reference = (document.get(key) for key in ("kind", "factors", "reference"))
        if kind not in ("equal", "recorded", "fitted") or not isinstance(factors, Mapping):
            raise ValueError("exposures need a kind and factors")
        named = {str(name): tuple(float(each) for each in row) for name, row in factors.items()}
        known = [each for row in named.values() for each in row] + ([] if reference is None else [float(reference)])
        if any(len(row) != 3 for row in named.values()) or not all(math.isfinite(v) and v > 0 for v in known):
            raise ValueError("factors of exposures are three positive numbers")
        return cls(kind, named, None if reference is None else float(reference))  # type: ignore[arg-type]


EQUAL_EXPOSURES = PhotographExposures()


def with_recorded_exposures(capture: Capture) -> Capture:
    """The capture with the exposures that EXIF data record; unchanged unless all views have one and some differ."""
    recorded = [recorded_exposure(view) for view in capture.views]
    known = [each for each in recorded if each is not None]
    if not known or len(known) < len(recorded) or max(known) < LEAST_RECORDED_RATIO * min(known):
        return capture
    views = (replace(v, recorded_exposure=each) for v, each in zip(capture.views, recorded, strict=True))
    return replace(capture, views=tuple(views))


def check_recorded_exposures(capture: Capture) -> None:
    """`CaptureError` unless each view has a recorded exposure (`with_recorded_exposures`)."""
    if any(view.recorded_exposure is None for view in capture.views):
        raise CaptureError(
            f"{capture.path}: the photographs record no different exposures in their EXIF data; use "
            "--set reflectance.exposures=fitted or auto"
        )


def recorded_exposure(view: View) -> float | None:
    """What the reader found, or else the EXIF data of the file; None where there is nothing."""
    if view.recorded_exposure is not None or view.path is None:
        return view.recorded_exposure
    return camera_record(view.path).exposure or None


def _mean_recorded(capture: Capture) -> float:
    """Geometric mean of the recorded exposures."""
    known = [view.recorded_exposure for view in capture.views if view.recorded_exposure is not None]
    return math.exp(sum(math.log(each) for each in known) / len(known))
