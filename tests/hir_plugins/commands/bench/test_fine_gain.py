"""The study of the least gain of the fine candidate: nothing is computed twice, and the table says what rows say."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks import fine_gain
from benchmarks.fine_gain import NEVER, VALUES, computed_once, table
from hir_core.stages.geometry import confirmed_movement, geometry_fit
from hir_core.stages.geometry.photo_consistency import photo_refinement
from hir_core.stages.geometry.photo_consistency.photo_pass import plan_passes
from tests.fixtures.scenes import icosphere


def test_today_is_the_first_value_and_the_last_refuses_every_gain() -> None:
    assert VALUES[0] == photo_refinement.LEAST_FINE_GAIN and VALUES[-1] == NEVER
    found = confirmed_movement.confirmed_share((0.0, 1.0), fine_gain.np.array([[1.0] * 6, [0.01] * 6]), NEVER)
    assert found.gain > 0.9 and found.share < 1e-9


def test_the_same_fit_is_computed_once_and_another_mesh_views_or_pass_again(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    def fit_pass(mesh: Any, *rest: Any) -> Any:
        calls.append(rest)
        return mesh, object()

    def silhouettes(mesh: Any, fit: Any, error: float) -> Any:
        calls.append(fit)
        return mesh, [], []

    def prepare(mesh: Any, *rest: Any) -> Any:
        calls.append(rest)
        return SimpleNamespace(train=[0, 1])

    monkeypatch.setattr(photo_refinement, "fit_pass", fit_pass)
    monkeypatch.setattr(geometry_fit, "_prepare", prepare)
    monkeypatch.setattr(geometry_fit, "_fit_silhouettes", silhouettes)
    mesh = icosphere(1)
    moved = mesh.with_positions(mesh.positions * 2)
    [first, *_], last = plan_passes([2, 1], 10)
    with computed_once():

        def fitted(mesh: Any = mesh, train: tuple[int, ...] = (0, 1), plan: Any = first, steps: int = 7) -> Any:
            return photo_refinement.fit_pass(mesh, None, None, train, None, None, None, plan, steps)  # type: ignore[arg-type]

        found = fitted()
        assert fitted() is found and fitted(replace(mesh)) is found and len(calls) == 1
        others = (fitted(moved), fitted(train=(0, 1, 2)), fitted(plan=last))
        assert len(calls) == 4 and all(other is not found for other in others)
        views: Any = geometry_fit._prepare(mesh, None, None, None)  # type: ignore[arg-type]
        assert geometry_fit._prepare(mesh, None, None, None) is views and len(calls) == 5  # type: ignore[arg-type]
        once = geometry_fit._fit_silhouettes(mesh, views, 0.1)
        assert geometry_fit._fit_silhouettes(mesh, views, 0.1) is once and len(calls) == 6
    fitted_again = photo_refinement.fit_pass(mesh, None, None, (0, 1), None, None, None, first, 7)  # type: ignore[arg-type]
    assert fitted_again is not found and len(calls) == 7


def test_the_table_has_shares_errors_and_verdicts() -> None:
    rows = []
    for number, capture in enumerate(("bowl", "leaf", "mug")):
        for value in VALUES:
            better = 0.9 if value == VALUES[1] else 1.0
            row = {"capture": capture, "seed": 0, "least_fine_gain": value, "share": 0.5, "gain": 0.1, "noise": 0.01}
            rows.append(row | {"chamfer": better * 0.001 * (1 + number), "normals_deg": 5.0 + number})
    text = table(rows)
    assert text.count("\n| bowl | 0.100 ± 0.010 | 0.50, 0.50, 0.50, 0.50 | 0.001000, 0.000900, ") == 1
    assert f"| {VALUES[1]:g} | Chamfer distance | +10.54 ± 0.00 | better |" in text
    assert f"| {VALUES[1]:g} | normals | +0.00 ± 0.00 | no difference |" in text
    assert "| never | Chamfer distance | +0.00 ± 0.00 | no difference |" in text
