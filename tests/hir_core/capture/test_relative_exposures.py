"""Exposures are found from the colours of the same places, take by take; equal photographs stay as they are."""

from __future__ import annotations

import numpy as np
import pytest

from hir_core.capture.relative_exposures import corrections_of_takes

VIEWS, POINTS = 60, 300


def _seen(factors: np.ndarray, noise: float = 0.01) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colours of places in photographs with these factors, where they are seen, and directions to the cameras."""
    rng = np.random.default_rng(5)
    albedo = rng.uniform(0.1, 0.5, (POINTS, 3))
    color = albedo * factors[:, None] * np.exp(rng.normal(0, noise, (VIEWS, POINTS, 3)))
    known = rng.uniform(size=(VIEWS, POINTS, 1)) < 0.5
    return color, np.broadcast_to(known, color.shape), rng.normal(size=(VIEWS, 3))


def test_corrections_undo_what_was_changed() -> None:
    factors = np.exp(np.random.default_rng(1).uniform(-0.7, 0.7, (VIEWS, 3)))
    found = corrections_of_takes(*_seen(factors), takes=[0] * VIEWS)
    assert found is not None
    left = np.log(found * factors)
    assert left.std(axis=0).max() < 0.2 * np.log(factors).std(axis=0).min()  # what changes smoothly with the camera


def test_equal_photographs_need_none() -> None:
    assert corrections_of_takes(*_seen(np.ones((VIEWS, 3))), takes=[0] * VIEWS) is None


def test_each_take_has_a_light_of_its_own() -> None:
    """The second take is twice as bright; within both takes photographs are equal, so nothing is corrected."""
    factors = np.repeat([[1.0], [2.0]], VIEWS // 2, axis=0) * np.ones((1, 3))
    takes = [0] * (VIEWS // 2) + [1] * (VIEWS // 2)
    assert corrections_of_takes(*_seen(factors), takes=takes) is None
    assert corrections_of_takes(*_seen(factors), takes=[0] * VIEWS) is not None


@pytest.mark.parametrize("case", ["unseen view", "black", "one view", "infinite"])
def test_degenerate_photographs_give_finite_factors(case: str) -> None:
    color, known, toward = _seen(
        np.exp(np.linspace(-0.5, 0.5, VIEWS))[np.random.default_rng(2).permutation(VIEWS), None]
    )
    known = known.copy()
    if case == "unseen view":
        known[3] = False
    elif case == "black":
        color[3] = 0
    elif case == "infinite":
        color[3, :5], color[4, :5] = np.inf, np.nan
    else:
        color, known, toward = color[:1], known[:1], toward[:1]
    found = corrections_of_takes(color, known, toward, takes=[0] * len(color))
    assert (found is None) == (case == "one view")
    assert found is None or (np.isfinite(found).all() and (found > 0).all())
