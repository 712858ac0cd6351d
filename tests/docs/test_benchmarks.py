"""docs/benchmarks.md and README's table are what tools/write_benchmarks.py makes of the stored results."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from tests.docs.checkout import ROOT, tool

TOOL = tool("write_benchmarks")
ADVICE = "run: python tools/write_benchmarks.py"


def test_page_is_what_the_results_give() -> None:
    assert TOOL.page() == (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8"), ADVICE


def test_table_of_the_readme_is_that_of_the_results() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.count(TOOL.BEGIN) == 1 and readme.count(TOOL.END) == 1
    assert TOOL.with_table(readme) == readme, ADVICE
    assert TOOL.runs_table(TOOL.whole_runs()) in readme


def test_accuracy_of_the_fast_renderer_is_that_of_the_stored_run() -> None:
    page = (ROOT / "docs" / "reflectance.md").read_text(encoding="utf-8")
    assert page.count(TOOL.SHADING_BEGIN) == 1 and page.count(TOOL.SHADING_END) == 1
    assert TOOL.with_shading(page) == page, ADVICE


def test_each_suite_has_one_plot() -> None:
    """Plots are in docs/images alone: the tool removes those that `hir bench` writes beside its results."""
    assert not list(TOOL.RESULTS.rglob("*.svg")), ADVICE
    measured = [suite for suite in TOOL.SUITES if (TOOL.RESULTS / f"{suite}.json").is_file()]
    assert measured and all(TOOL.plot(suite).is_file() for suite in measured)
    assert {path.name for path in TOOL.IMAGES.glob("bench_*.svg")} == {TOOL.plot(suite).name for suite in measured}


def stored_results() -> list[Path]:
    return sorted(TOOL.RESULTS.rglob("*.json"))


@pytest.mark.parametrize("path", stored_results(), ids=lambda path: path.stem)
def test_a_stored_result_says_when_where_and_by_which_code_it_was_measured(path: Path) -> None:
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    assert document.get("commit") or document.get("stored_with")
    for measured in document.get("runs", [document]) if path.stem == "whole_runs" else [document]:
        date.fromisoformat(measured["date"])
        assert measured.get("processor") or measured["machine"]["processor"]


MACHINE_NOT_RECORDED = {"exposure_accuracy"}
"""Measured before the program recorded it; docs/studies/exposures.md says so. New rows have it."""


@pytest.mark.parametrize("path", sorted(TOOL.RESULTS.rglob("*.jsonl")), ids=lambda path: path.stem)
def test_each_stored_row_says_when_where_and_by_which_code_it_was_measured(path: Path) -> None:
    rows: list[dict[str, Any]] = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    assert rows
    for row in rows:
        assert row["commit"]
        date.fromisoformat(row["date"])
        if row["machine"] is None:
            assert path.stem in MACHINE_NOT_RECORDED
        else:
            assert row["machine"]["processor"]


def test_rows_of_captures_that_were_not_measured_again_stay() -> None:
    stored = [{"capture": "spot", "date": "2026-11-28"}, {"capture": "chair", "date": "2026-11-27"}]
    found = TOOL.updated(
        stored, [{"capture": "avocado", "date": "2026-11-29"}, {"capture": "spot", "date": "2026-11-29"}]
    )
    assert [(row["capture"], row["date"][-2:]) for row in found] == [("spot", "29"), ("chair", "27"), ("avocado", "29")]
