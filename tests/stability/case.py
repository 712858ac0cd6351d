"""One numerical edge case: the result of hir, the result of a naive formula, and the truth in many digits.

A case is valid only where the naive formula fails, in float32 and in float64: its result is not finite, it raises, or
its error exceeds the tolerance of the case.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import mpmath
import numpy as np
import torch

DIGITS = 60
"""Decimal digits of the truth, enough for every cancellation of a float32 formula."""

Area = Literal["initialization", "geometry", "reflectance", "export"]


@dataclass(frozen=True)
class Case:
    """A test, and an input of a row of docs/stability.md."""

    area: Area
    function: str
    """Dotted name of the tested function."""
    input_text: str
    """Description of the input."""
    expected: str
    ours: Callable[[], Any]
    """Calls the function."""
    naive: str | Callable[[], Any]
    """A formula in the names of `values`, in float32 and float64; or a function, with `formula` as its text."""
    truth: str | float | Callable[[], Any] = ""
    """The same in many digits; by default the naive formula itself."""
    values: Mapping[str, float] = field(default_factory=dict)
    exact: Mapping[str, Any] = field(default_factory=dict)
    """Values for the truth that float32 cannot represent, as mpmath numbers; `values` has the others."""
    tolerance: float = 1e-5
    """Largest error: |result − truth| over |truth|, or over 1 where the truth is 0."""
    formula: str = ""
    """Text for a naive function."""

    @property
    def name(self) -> str:
        """An identifier for pytest."""
        return f"{self.area}-{self.function.rpartition('.')[2]}-{self.input_text}".replace(" ", "_")

    @property
    def shown(self) -> str:
        """The naive formula as text."""
        return self.naive if isinstance(self.naive, str) else self.formula


@dataclass(frozen=True)
class Outcome:
    """The result of a case."""

    result: np.ndarray
    truth: np.ndarray
    error: float
    naive: np.ndarray | None
    """None where the naive formula raised."""
    naive_error: float
    """The smaller one of the errors in float32 and in float64."""


def examine(case: Case) -> Outcome:
    """Computes result, truth and naive result."""
    result, truth = array_of(case.ours()), array_of(_truth(case))
    naive, precise = _naive(case, np.float32), _naive(case, np.float64)
    return Outcome(result, truth, error_of(result, truth), naive, min(error_of(naive, truth), error_of(precise, truth)))


def error_of(found: np.ndarray | None, truth: np.ndarray) -> float:
    """Largest difference relative to the largest true value; infinite where a value is missing or not finite."""
    if found is None or found.shape != truth.shape or not np.isfinite(found).all():
        return float("inf")
    size = float(np.abs(truth).max(initial=0.0)) or 1.0
    return float(np.abs(found - truth).max(initial=0.0)) / size


def array_of(value: Any) -> np.ndarray:
    """Numbers, lists of them, arrays and tensors as float64."""
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, list | tuple):
        return np.array([array_of(v) for v in value], np.float64)
    if isinstance(value, mpmath.mpf | mpmath.mpc):
        return np.asarray(float(mpmath.re(value)))
    return np.asarray(value, np.float64)


def _truth(case: Case) -> Any:
    if callable(case.truth):
        return case.truth()
    if isinstance(case.truth, int | float):
        return case.truth
    with mpmath.workdps(DIGITS):
        values = {name: mpmath.mpf(float(np.float32(value))) for name, value in case.values.items()}
        # mpmath reads decimal constants of a formula as the same float64 as Python
        return eval(case.truth or case.shown, _MANY_DIGITS, values | dict(case.exact))


def _naive(case: Case, dtype: type[np.floating[Any]]) -> np.ndarray | None:
    """The formula of text on the values as float32 has them, evaluated in `dtype`; a function chooses its own types."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            if callable(case.naive):
                return array_of(case.naive())
            return array_of(eval(case.naive, _NUMPY, {n: dtype(np.float32(v)) for n, v in case.values.items()}))
        except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError):
            return None


_NAMES = ("sqrt", "exp", "log", "sin", "cos", "tan")
_NUMPY: dict[str, Any] = {name: getattr(np, name) for name in _NAMES}
_NUMPY |= {"pi": np.pi, "acos": np.arccos, "atan2": np.arctan2, "cbrt": np.cbrt, "hypot": np.hypot}
_MANY_DIGITS: dict[str, Any] = {name: getattr(mpmath, name) for name in (*_NAMES, "acos", "atan2", "cbrt", "hypot")}
_MANY_DIGITS["pi"] = mpmath.pi
