"""Every hard case of docs/stability.md: finite, right, and beyond what its naive formula manages."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.stability import table
from tests.stability.case import Case, examine
from tests.stability.table import PAGE, TITLES, all_cases

ALL = all_cases()


@pytest.mark.parametrize("case", ALL, ids=lambda case: case.name)
def test_hard_case(case: Case) -> None:
    found = examine(case)
    assert found.error <= case.tolerance, f"{found.result} is not {found.truth}"
    assert not found.naive_error <= case.tolerance, f"the naive formula gives {found.naive}: not a hard case"


def test_cases_are_distinct_and_all_kinds_of_work_have_some() -> None:
    assert len({case.name for case in ALL}) == len(ALL)
    counts = Counter(case.area for case in ALL)
    assert len(ALL) >= 120 and min(counts.values()) >= 10 and len(counts) == 4, counts


def test_page_has_a_row_for_every_case() -> None:
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert len(rows) == len(ALL), "run: make stability"
    for case, row in zip(sorted(ALL, key=lambda c: list(TITLES).index(c.area)), rows, strict=True):
        assert case.input_text in row and case.expected in row, f"run: make stability ({case.name})"


def test_help_of_the_page_writer_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "stability.md"
    monkeypatch.setattr(table, "PAGE", page)
    for arguments in (["--help"], ["--unknown"]):
        with pytest.raises(SystemExit):
            table.main(arguments)
    assert not page.exists()
