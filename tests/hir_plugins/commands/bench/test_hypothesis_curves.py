"""The table of `benchmarks.hypothesis_curves`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.hypothesis_curves import table


def test_a_hypothesis_that_one_file_lacks_keeps_its_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = tmp_path / "before.jsonl", tmp_path / "after.jsonl"

    def line(**last: float) -> str:
        found = {name: {"held_out_db": [1.0, db]} for name, db in last.items()}
        return json.dumps({"capture": "06", "hypotheses": found}) + "\n"

    before.write_text(line(metal=20.0) + line(metal=22.0))
    after.write_text(line(metal=24.0, mixed=23.0))
    table([before, after])
    assert capsys.readouterr().out.splitlines()[2:] == [
        "| 06 | metal | 21.00 ± 1.41 | 24.00 | +3.00 |",
        "| 06 | mixed | – | 23.00 | – |",
    ]
