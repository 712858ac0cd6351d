"""Held-out views: those of one take, and how they are spread over several."""

from __future__ import annotations

import numpy as np
import pytest

from hir_core.stages.held_out_views import (
    MIN_VIEWS_OF_FOLD,
    folds_of_a_comparison,
    held_out_for_geometry,
    held_out_for_model_selection,
    judging_views,
    model_selection_folds,
)

TAKES = {
    "two halves": [0] * 20 + [1] * 20,
    "interleaved": [0, 1] * 12,
    "unequal": [0] * 41 + [1] * 7,
    "one photograph": [0] * 12 + [1],
    "small ones": [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3,
    "pairs": [0, 0, 1, 1, 2, 2, 3, 3, 4, 4],
}


def assert_half_of_each_take_is_left(held_out: list[int], takes: list[int]) -> None:
    assert len(set(held_out)) == len(held_out) and set(held_out) <= set(range(len(takes)))
    for take in set(takes):
        assert 2 * sum(takes[v] == take for v in held_out) <= takes.count(take)


@pytest.mark.parametrize("views", [6, 7, 11, 12, 25, 48, 100])
def test_views_of_one_take_are_held_out_as_without_takes(views: int) -> None:
    takes = [0] * views
    assert model_selection_folds(views, takes) == model_selection_folds(views)
    count = min(views // 2, max(6, views // 8))
    assert model_selection_folds(views)[0][1] == [int((i + 0.5) * views / count) for i in range(count)]
    assert model_selection_folds(views)[1][1] == [int(i * views / count) for i in range(count)]
    for share in (0.08, 0.15, 0.7):
        held_out = held_out_for_geometry(views, share)
        assert held_out == held_out_for_geometry(views, share, takes)
        assert len(held_out) == (round(views * share) if views >= 10 else 0)
        assert judging_views(views, held_out) == judging_views(views, held_out, takes)


@pytest.mark.parametrize(("views", "folds"), [(3, 0), (6, 2), (11, 2), (12, 1), (48, 1)])
def test_folds_of_a_comparison_have_six_judges(views: int, folds: int) -> None:
    found = model_selection_folds(views)
    assert folds_of_a_comparison(found) == range(folds)
    assert not folds or sum(len(held_out) for _, held_out in found[:folds]) >= 6


@pytest.mark.parametrize("takes", TAKES.values(), ids=TAKES)
def test_each_take_leaves_half_of_its_views_to_a_fit(takes: list[int]) -> None:
    folds = model_selection_folds(len(takes), takes)
    assert len(folds) == 2 and not set(folds[0][1]) & set(folds[1][1])
    for training, held_out in folds:
        assert_half_of_each_take_is_left(held_out, takes)
        assert sorted(training + held_out) == list(range(len(takes))) and len(held_out) >= MIN_VIEWS_OF_FOLD
    assert held_out_for_model_selection(len(takes), takes) == folds[0]
    for share in (0.08, 0.15, 1.0):
        held_out = held_out_for_geometry(len(takes), share, takes)
        assert held_out
        assert_half_of_each_take_is_left(held_out, takes)
        judges = judging_views(len(takes), held_out, takes)
        assert set(held_out) <= set(judges)
        assert_half_of_each_take_is_left(judges, takes)


def test_random_takes_leave_half_of_their_views() -> None:
    random = np.random.default_rng(0)
    for _ in range(300):
        takes = [int(t) for t in random.integers(random.integers(1, 9) + 1, size=random.integers(10, 90))]
        numbers = {take: number for number, take in enumerate(dict.fromkeys(takes))}
        takes = [numbers[take] for take in takes]
        if len(numbers) == 1:
            continue
        for _, held_out in model_selection_folds(len(takes), takes):
            assert_half_of_each_take_is_left(held_out, takes)
        held_out = held_out_for_geometry(len(takes), float(random.uniform(0, 1)), takes)
        assert_half_of_each_take_is_left(judging_views(len(takes), held_out, takes), takes)


def test_held_out_views_are_spread_over_the_takes() -> None:
    takes = TAKES["two halves"]
    for _, held_out in model_selection_folds(40, takes):
        assert [sum(takes[v] == take for v in held_out) for take in (0, 1)] == [3, 3]
    # one photograph in eight is held out: without the takes these would all be of the first one
    alternating = [v % 8 // 4 for v in range(96)]
    held_out = held_out_for_geometry(96, 1 / 8, alternating)
    assert [sum(alternating[v] == take for v in held_out) for take in (0, 1)] == [6, 6]
    judges = judging_views(40, held_out_for_geometry(40, 0.08, takes), takes)
    assert [sum(takes[v] == take for v in judges) for take in (0, 1)] == [3, 3]


def test_takes_of_one_photograph_hold_none_out() -> None:
    takes = list(range(12))
    assert model_selection_folds(12, takes) == [] and held_out_for_geometry(12, 0.15, takes) == []
    assert held_out_for_model_selection(12, takes) == (takes, [])
    few = [0, 0, 0, 0, 1, 2]  # two of six could be held out
    assert model_selection_folds(6, few) == []
