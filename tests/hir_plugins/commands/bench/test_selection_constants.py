"""The study of the selection's constants: fits are shared by their arguments, a constant changes and comes back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.default_values import DEFAULT_VALUES
from benchmarks.selection_constants import NAMES, changed, changed_decisions, shared_fits
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.held_out_comparison import differs, is_significant
from hir_core.stages.reflectance.selection.refinement_selection import RefinementSelection
from hir_core.stages.reflectance.selection.successive_halving import can_catch_up
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver


def test_fits_and_errors_are_shared_by_their_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []

    def fit(solver: object, spec: ModelSpec, initial: object, *more: object) -> object:
        made.append(initial)
        return SimpleNamespace()

    def errors(solver: object, fitted: object, views: object) -> object:
        made.append(views)
        return np.zeros(2)

    monkeypatch.setattr(TransportSolver, "fit", fit)
    monkeypatch.setattr(TransportSolver, "errors", errors)
    solver, spec = SimpleNamespace(), ModelSpec()
    with shared_fits() as shared:
        again: Any = TransportSolver.fit
        one = again(solver, spec, None, [0, 1], 1.0, lambda share: None)
        assert again(solver, spec, None, (0, 1), 1.0, lambda share: None) is one
        two = again(solver, spec, one, [0, 1], 1.0, lambda share: None)
        others = (
            again(solver, spec, two, [0, 1], 1.0, lambda share: None),
            again(solver, spec, one, [0], 1.0, lambda share: None),
            again(solver, spec, one, [0, 1], 0.5, lambda share: None),
            again(solver, spec, one, [0, 1], 1.0, lambda share: None, None, 0.5),
            again(solver, ModelSpec(bounces=3), one, [0, 1], 1.0, lambda share: None),
            again(SimpleNamespace(), spec, one, [0, 1], 1.0, lambda share: None),
        )
        assert len({id(each) for each in (one, two, *others)}) == len(made) == 8
        compared: Any = TransportSolver.errors
        assert compared(solver, one, [2, 3]) is compared(solver, one, [2, 3])
        assert compared(solver, one, [2]) is not compared(solver, two, [2]) and len(made) == 11
        assert shared.number(None) is None and shared.number(one) != shared.number(two)
    assert TransportSolver.fit is fit and TransportSolver.errors is errors


def test_constants_change_every_decision_and_come_back() -> None:
    errors = np.array([1.0] * 100)
    behind: Any = SimpleNamespace(
        curve_db=[20.0], gap_db=7.5, standard_error_db=1.0, last=SimpleNamespace(errors=errors)
    )
    decisions = {
        "required_standard_errors": lambda: is_significant(0.3, 0.2, 100),
        "standard_errors_of_hypotheses": lambda: differs(0.4, 0.2, 100),
        "drop_standard_errors": lambda: not can_catch_up(behind, 2),
    }
    before = {name: decide() for name, decide in decisions.items()}
    for name, decide in decisions.items():
        low, high = DEFAULT_VALUES[name].candidates
        with changed(name, low):
            lower = decide()
        with changed(name, high):
            higher = decide()
        assert (lower, higher) == (True, False), name
    assert before == {name: decide() for name, decide in decisions.items()}
    defaults = RefinementSelection._compare.__defaults__
    with changed("required_standard_errors", 2.0):
        assert RefinementSelection._compare.__defaults__ == (False, 2.0)
    assert RefinementSelection._compare.__defaults__ == defaults


def test_changed_decisions_are_listed() -> None:
    name = NAMES[0]
    value, other = DEFAULT_VALUES[name].value, DEFAULT_VALUES[name].candidates[0]
    row = {"constant": name, "capture": "01_a", "seed": 2, "models": {str(value): "a", str(other): "b", "9": "a"}}
    assert changed_decisions([row]).splitlines()[2:] == [f"| {name} | {other} | 01_a | 2 | a | b |"]
