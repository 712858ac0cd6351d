"""docs/studies/paper_experiments.md is what the stored results give; a result belongs to one set of settings."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.checkout import ROOT


@pytest.fixture
def experiments(monkeypatch: pytest.MonkeyPatch) -> dict[str, ModuleType]:
    """Modules of the checkout's benchmarks."""
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.experiments import cells, page, studies

    return {"cells": cells, "page": page, "studies": studies}


def test_page_is_what_the_results_give(experiments: dict[str, ModuleType]) -> None:
    written = (ROOT / "docs" / "studies" / "paper_experiments.md").read_text(encoding="utf-8")
    assert experiments["page"].page() == written, "run: python -m benchmarks.experiments --page"


def test_a_result_of_other_settings_is_not_taken(
    experiments: dict[str, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = experiments["cells"]
    monkeypatch.setattr(cells, "RESULTS", tmp_path)
    cell = cells.Cell("one", "spot", 20, 128, settings=("seed=1",))
    assert cell.stored() is None
    (tmp_path / "one.json").write_text(json.dumps({"cell": asdict(cell), "seconds": 3.0}))
    assert cell.stored() == {"cell": json.loads(json.dumps(asdict(cell))), "seconds": 3.0}
    assert replace(cell, settings=("seed=2",)).stored() is None


def test_empty_cells_are_named(
    experiments: dict[str, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments["cells"], "RESULTS", tmp_path)
    page, images = experiments["page"], experiments["studies"].IMAGES
    text = page.study_table(images)
    assert text.count("| – | – |") and "Not run yet: 10 photographs; 20 photographs" in text
    assert "not measured yet" in page.paper_time()


def test_a_step_takes_what_lies_between_steps(experiments: dict[str, ModuleType]) -> None:
    """Not what a stage does before its first one and after its last."""
    per_step = experiments["cells"].seconds_per_step
    assert per_step([[1, 600.0], [2, 615.0], [4, 660.0], [4, 1800.0]]) == 20.0
    assert per_step([[1, 5.0], [1, 9.0]]) is None and per_step([]) is None


def test_time_of_the_paper_is_all_its_steps(
    experiments: dict[str, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments["cells"], "RESULTS", tmp_path)
    cell = experiments["studies"].PAPER_STEPS
    stages = {"geometry": {"seconds_per_step": 1.8}, "reflectance": {"seconds_per_step": 0.9}}
    (tmp_path / f"{cell.name}.json").write_text(json.dumps({"cell": asdict(cell), "stages": stages}))
    # 80 views, 200 steps each of 1.8 s and 400 of 0.9 s: 8 h + 8 h
    assert experiments["page"].paper_time().startswith("16 h, **extrapolated**: 16,000 steps of 1.80 s and 32,000")


def test_seconds_of_a_step_leave_preparation_out(experiments: dict[str, ModuleType]) -> None:
    per_step = experiments["cells"].seconds_per_step
    assert per_step([[1, 30.0], [3, 31.0], [5, 32.0]]) == pytest.approx(0.5)
    assert per_step([[1, 30.0]]) is None and per_step([]) is None
