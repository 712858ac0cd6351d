"""Pairs of path-traced pictures: their noise is measured, and low noise ends the rounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hir_core.metrics import Image
from hir_core.rendering import converged_pair as module
from hir_core.rendering.converged_pair import LOW_NOISE_DB, MAX_ROUNDS, converged_pair, noise_db

SIDE = 128


def noisy(label: str, sigma: float) -> Image:
    """A grey picture with noise of a standard deviation in linear values, of its own for each label."""
    rng = np.random.default_rng(sum(map(ord, label)) + 1000 * len(label))
    picture = np.ones((SIDE, SIDE, 4), np.float32)
    picture[..., :3] = 0.5 + rng.normal(0, sigma, (SIDE, SIDE, 3))
    return picture


@pytest.mark.parametrize(("sigma", "rounds"), [(0.005, 1), (0.028, 3), (0.3, MAX_ROUNDS)])
def test_noise_decides_how_many_rounds_there_are(sigma: float, rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    labels: list[str] = []

    def rendered(renderer: object, scene: object, camera: object, label: str) -> Image:
        labels.append(label)
        return noisy(label, sigma)

    monkeypatch.setattr(module, "render_view", rendered)
    nothing: Any = None
    first, second = converged_pair(nothing, nothing, nothing, "a view")
    assert len(labels) == len(set(labels)) == 2 * rounds, "every render has noise of its own"
    for picture in (first, second):
        assert picture[..., :3].std() == pytest.approx(sigma / np.sqrt(rounds), rel=0.05)
    assert (noise_db(first, second) >= LOW_NOISE_DB) == (rounds < MAX_ROUNDS)


def test_the_noise_is_that_of_the_mean_picture() -> None:
    first, second = noisy("a", 0.01), noisy("b", 0.01)
    middle, clean = (first + second) / 2, noisy("c", 0.0)
    true = noise_db(middle, clean) - 10 * np.log10(4)  # of one picture that is compared with the clean one
    assert noise_db(first, second) == pytest.approx(true, abs=0.2)


def test_without_an_object_there_is_no_noise() -> None:
    nothing = np.zeros((4, 4, 4), np.float32)
    assert noise_db(nothing, nothing) == float("inf")
