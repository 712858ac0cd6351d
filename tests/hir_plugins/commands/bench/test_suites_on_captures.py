"""The suites that need a capture with a true mesh, on the smallest one that they work on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hir_core.errors import InputError
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.inputs.bench_captures import made_smaller, stretched
from hir_plugins.commands.bench.peers import stock_mitsuba
from hir_plugins.commands.bench.suites import end_to_end_suite, initializers_suite, reflectance_fits

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def small(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve photographs of 128², with the true mesh."""
    return made_smaller(shared / "captures" / "spot", tmp_path_factory.mktemp("small") / "spot", 12, 128)


@pytest.fixture
def plan(small: Path, tmp_path: Path) -> Iterator[Plan]:
    yield Plan(PluginManager.discover(), captures=(small,), workspace=tmp_path, repeats=1)


def test_first_meshes_are_compared_with_the_truth(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every chain has a row; a hull of twelve views is within a tenth of the object of its truth."""
    monkeypatch.setattr(initializers_suite, "VIEWS", (12, 500))
    rows = {row.method: row for row in initializers_suite.initializers(plan)}
    assert {"visual_hull", "stereo", "stereo, poisson"} <= set(rows), list(rows)
    assert all(row.case == {"capture": "spot", "views": 12} for row in rows.values())
    assert 0 < rows["visual_hull"].errors["Chamfer, radii"] < 0.1
    for row in rows.values():
        assert row.errors or row.note.startswith("no mesh: "), row


def test_fits_on_the_true_mesh_stand_beside_other_programs(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """More effort is no worse by half a decibel, and all are judged on the same photographs, under other lights too."""
    monkeypatch.setattr(reflectance_fits, "EFFORTS", (0.1, 0.3))
    monkeypatch.setattr(reflectance_fits, "POLISH_STEPS", 3)
    monkeypatch.setattr(reflectance_fits, "TUNED_STEPS", (3, 40))
    monkeypatch.setattr(reflectance_fits, "PAPER_STEPS", (2,))
    monkeypatch.setattr(stock_mitsuba, "SECONDS", (3.0, 500.0))
    rows = list(reflectance_fits.fits(plan.captures[0], plan))
    ours = {(row.method, row.case["budget"]): row.errors for row in rows if row.role == "ours"}
    levels = [errors["unseen dB"] for (method, _), errors in ours.items() if method == "transport_ggx"]
    assert len(levels) == 2 and levels[1] > levels[0] - 0.5 and min(levels) > 15
    tuned = [errors["unseen dB"] for (method, _), errors in ours.items() if method == "mitsuba_ggx, tuned"]
    assert tuned[1] > tuned[0] + 2, "forty steps of path tracing against three"
    assert len(ours) == 6, list(ours)
    assert all({"unseen dB", "frame dB", "relight_0 scaled dB, frame"} <= set(errors) for errors in ours.values())
    assert all(errors["frame dB"] > errors["unseen dB"] for errors in ours.values())
    peers = [row for row in rows if row.role == "peer"]
    assert {row.note for row in peers if row.case["budget"] == "500 s"} == {"left out: above the limit"}
    measured = [row for row in peers if row.timing is not None]
    assert len(measured) == 3, [row.method for row in peers]
    assert all(5 < row.errors["unseen dB"] < 40 for row in measured if "unseen dB" in row.errors)


def test_a_whole_run_has_a_row_for_each_stage(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(end_to_end_suite, "VIEWS", (12, 20))
    monkeypatch.setattr(end_to_end_suite, "SIDES", (128, 512))
    rows = list(end_to_end_suite.end_to_end(plan))
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


def test_stretched_captures_have_as_many_and_as_large_photographs_as_asked(small: Path, tmp_path: Path) -> None:
    """More than there are come again; taking the folder a second time changes nothing."""
    folder = stretched(small, tmp_path / "large", 15, 160)
    assert end_to_end_suite.extent(folder) == (15, 160)
    before = (folder / "transforms_train.json").read_bytes()
    assert stretched(small, folder, 15, 160) == folder and (folder / "transforms_train.json").read_bytes() == before
    with pytest.raises(InputError, match="has no transforms_train"):
        made_smaller(tmp_path, tmp_path / "none", 2, 8)
    with pytest.raises(InputError, match="no train views"):
        end_to_end_suite.extent(tmp_path)
