"""Every hard case of docs/stability.md: finite, right, and beyond what its naive formula manages."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.stability import table
from tests.stability.case import Case, examine
from tests.stability.table import PAGE, TITLES, all_cases, rows_of

ALL = all_cases()


@pytest.mark.parametrize("case", ALL, ids=lambda case: case.name)
def test_hard_case(case: Case) -> None:
    found = examine(case)
    assert found.error <= case.tolerance, f"{found.result} is not {found.truth}"
    assert not found.naive_error <= case.tolerance, f"the naive formula gives {found.naive}: not a hard case"


def test_cases_are_distinct_and_all_kinds_of_work_have_some() -> None:
    assert len({case.name for case in ALL}) == len(ALL)
    counts = Counter(case.area for case in ALL)
    assert len(rows_of(ALL)) >= 90 and min(counts.values()) >= 10 and len(counts) == 4, counts


def test_page_has_a_row_for_every_formula() -> None:
    """Which input of a row has the largest error may differ between processors."""
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    expected = rows_of(sorted(ALL, key=lambda c: list(TITLES).index(c.area)))
    assert len(rows) == len(expected), "run: make stability"
    for cases, row in zip(expected, rows, strict=True):
        others = f" (and {len(cases) - 1} more) |" if len(cases) > 1 else " |"
        found = any(f"| {case.input_text}{others}" in row and case.expected in row for case in cases)
        assert found, f"run: make stability ({cases[0].name})"


def test_help_of_the_page_writer_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "stability.md"
    monkeypatch.setattr(table, "PAGE", page)
    for arguments in (["--help"], ["--unknown"]):
        with pytest.raises(SystemExit):
            table.main(arguments)
    assert not page.exists()
