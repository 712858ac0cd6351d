"""`hir bench atlas`: seams by a known answer, and rows of both methods."""

from __future__ import annotations

import numpy as np
import pytest

from hir_core.mesh import uv_charts
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.suites.atlas_suite import atlas_rows, seam_length


def test_a_square_cut_along_its_diagonal_has_a_seam_of_its_length() -> None:
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    assert seam_length(positions, faces, faces) == 0
    assert seam_length(positions, faces, np.array([[0, 1, 2], [3, 4, 5]])) == pytest.approx(np.sqrt(2))


def test_both_methods_have_the_same_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """On noise, the charts of a simplified copy have shorter seams; a size above the limit has a note."""
    monkeypatch.setattr(uv_charts, "COARSE_FACES", 600)
    options = BenchOptions(PluginManager.discover(), limit_seconds=1e-4)
    rows = list(atlas_rows(options, subdivisions=(3, 4), noises=(0.3,)))
    assert [(row.case["triangles"], row.method, row.role) for row in rows[:2]] == [
        (1280, "xatlas", "reference"),
        (1280, "charts of a simplified copy", "ours"),
    ]
    theirs, ours = (row.errors for row in rows[:2])
    assert set(ours) == {"charts", "seams", "stretch − 1", "unused"}
    assert 0 < ours["seams"] < theirs["seams"] and 0 < ours["unused"] < 0.8
    assert all(row.timing is None and row.note.startswith("omitted") for row in rows[2:]) and len(rows) == 4
