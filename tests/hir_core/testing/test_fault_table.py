"""`hir check-plugin` names the fault of each broken plugin of the folder `faults`, as "
"docs/writing_plugins/faults.md says."""

from __future__ import annotations

import re
import time

import pytest

from tests.docs.checkout import tool

table = tool("write_fault_table")
LIMIT_S = 60.0

SLOW = ("initializer_other_frame", "light_turned_back", "light_fixed_to_the_world", "slow_import")
MARKS = {fault: [pytest.mark.gpu] for fault in table.NEEDS_CUDA} | {fault: [pytest.mark.slow] for fault in SLOW}
CASES = [pytest.param(fault, id=fault, marks=MARKS.get(fault, [])) for fault in table.FAULTS]


def without_numbers(text: str) -> str:
    """Numbers differ in their last digits between machines."""
    return re.sub(r"-?\d+(\.\d+)?(e[+-]?\d+)?", "#", text)


@pytest.mark.slow
@pytest.mark.parametrize("fault", CASES)
def test_no_other_contract_fails(fault: str) -> None:
    start = time.process_time()
    failed = [result for result in table.results_of(fault) if result.outcome == "failed"]
    spent = time.process_time() - start
    assert [result.check for result in failed] == [table.FAULTS[fault]], [result.detail for result in failed]
    assert spent < LIMIT_S


@pytest.mark.parametrize("fault", CASES)
def test_the_contract_says_what_the_page_says(fault: str) -> None:
    results = table.results_of(fault, only=table.FAULTS[fault])
    failed = [result for result in results if result.outcome == "failed"]
    assert [result.check for result in failed] == [table.FAULTS[fault]], [result.detail for result in results]
    if fault in table.NEEDS_CUDA:
        return
    row = table.row(fault, table.FAULTS[fault], table.sentence_of(failed[0]))
    assert without_numbers(row) == without_numbers(table.stored_rows()[fault]), "run: python tools/write_fault_table.py"


def test_every_broken_plugin_is_in_the_page() -> None:
    files = {path.stem for path in table.FAULTS_FOLDER.glob("*.py") if not path.stem.startswith("sound")}
    assert files == set(table.FAULTS) == set(table.stored_rows())
