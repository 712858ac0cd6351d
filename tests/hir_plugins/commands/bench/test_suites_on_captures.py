"""The suites that need a capture with a true mesh, on a small one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hir_core.errors import InputError
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_captures import capture_size, make_reduced_capture, make_resized_capture
from hir_plugins.commands.bench.suites import end_to_end_suite, initializers_suite
from hir_plugins.commands.bench.suites.reflectance_fits import FitBudgets, fit_rows
from tests.fixtures.runs import QUICK

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def small(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve photographs of 128², with the true mesh."""
    return make_reduced_capture(shared / "captures" / "spot", tmp_path_factory.mktemp("small") / "spot", 12, 128)


@pytest.fixture
def bench_options(small: Path, tmp_path: Path) -> Iterator[BenchOptions]:
    yield BenchOptions(PluginManager.discover(), captures=(small,), workspace=tmp_path, repeats=1)


def test_initial_meshes_are_compared_with_the_true_mesh(bench_options: BenchOptions) -> None:
    """Every chain has a row; a hull of twelve views is within a tenth of the object of its truth."""
    rows = {row.method: row for row in initializers_suite.initializer_rows(bench_options, view_counts=(12, 500))}
    assert {"visual_hull", "stereo", "stereo, poisson"} <= set(rows), list(rows)
    assert all(row.case == {"capture": "spot", "views": 12} for row in rows.values())
    assert 0 < rows["visual_hull"].errors["Chamfer, radii"] < 0.1
    for row in rows.values():
        assert row.errors or row.note.startswith("no mesh: "), row


def test_fits_on_the_true_mesh_are_compared_with_other_programs(bench_options: BenchOptions) -> None:
    """More effort is at most 0.5 dB worse; all methods are evaluated on the same views, under other lights too."""
    budgets = FitBudgets(
        efforts=(0.1, 0.3),
        path_traced_steps=3,
        tuned_steps=(3, 40),
        paper_steps=(2,),
        stock_limits_s=(3.0, 500.0),
    )
    rows = list(fit_rows(bench_options.captures[0], bench_options, budgets))
    ours = {(row.method, row.case["budget"]): row.errors for row in rows if row.role == "ours"}
    levels = [errors["unseen dB"] for (method, _), errors in ours.items() if method == "transport_ggx"]
    assert len(levels) == 2 and levels[1] > levels[0] - 0.5 and min(levels) > 15
    tuned = [errors["unseen dB"] for (method, _), errors in ours.items() if method == "mitsuba_ggx, tuned"]
    assert tuned[1] > tuned[0] + 2, "forty steps of path tracing against three"
    assert len(ours) == 6, list(ours)
    assert all({"unseen dB", "frame dB", "relight_0 scaled dB, frame"} <= set(errors) for errors in ours.values())
    assert all(errors["frame dB"] > errors["unseen dB"] for errors in ours.values())
    peers = [row for row in rows if row.role == "peer"]
    assert {row.note for row in peers if row.case["budget"] == "500 s"} == {"omitted: above the limit"}
    measured = [row for row in peers if row.timing is not None]
    assert len(measured) == 3, [row.method for row in peers]
    assert all(5 < row.errors["unseen dB"] < 40 for row in measured if "unseen dB" in row.errors)


def test_a_whole_run_has_a_row_for_each_stage(bench_options: BenchOptions) -> None:
    rows = list(end_to_end_suite.end_to_end_rows(bench_options, (12, 20), (128, 512), QUICK))
    assert [row.method for row in rows if row.case["views"] == 12 and row.case["image"] == 128] == [
        "initializer",
        "geometry",
        "atlas",
        "reflectance",
        "bake",
        "export",
        "whole run",
    ]
    whole = next(row for row in rows if row.method == "whole run" and row.timing is not None)
    assert whole.timing is not None and 0 < whole.timing.cpu < 4 * whole.timing.median
    assert whole.errors["unseen dB, frame"] > whole.errors["unseen dB, object"] > 10
    assert {row.note for row in rows if row.timing is None} == {"the capture has 12 views of 128 pixels"}


def test_resized_captures_have_the_requested_number_and_size_of_photographs(small: Path, tmp_path: Path) -> None:
    """Missing views are repeated; an existing copy is not changed."""
    folder = make_resized_capture(small, tmp_path / "large", 15, 160)
    assert capture_size(folder) == (15, 160)
    before = (folder / "transforms_train.json").read_bytes()
    assert (
        make_resized_capture(small, folder, 15, 160) == folder
        and (folder / "transforms_train.json").read_bytes() == before
    )
    with pytest.raises(InputError, match="has no transforms_train"):
        make_reduced_capture(tmp_path, tmp_path / "none", 2, 8)
    with pytest.raises(InputError, match="no readable train views"):
        capture_size(tmp_path)
