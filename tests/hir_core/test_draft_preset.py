"""A draft writes its files, and a run with `fast` goes on in its folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from hir_core.files.json_documents import read_json
from hir_core.pipeline import Run
from hir_core.report import pictures_damage
from hir_core.run.run_directory import RunDirectory
from tests.fixtures.command_line import hir
from tests.fixtures.runs import QUICK


@pytest.mark.slow
def test_a_draft_is_followed_by_a_run(tiny_capture: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert hir("reconstruct", tiny_capture, "-o", run, "--preset", "draft") == 0
    names = {path.name for path in (run / "exports").iterdir()}
    assert {"tiny.glb", "tiny.usdz"} <= names and (run / "report.html").exists()
    assert read_json(run / "report" / "views.json")["side"] == 256
    settings = [word for text in QUICK for word in ("--set", text)]
    assert hir("reconstruct", tiny_capture, "-o", run, "--resume", "--preset", "fast", *settings) == 0
    assert read_json(run / "run.json")["settings"]["preset"] == "fast"
    assert read_json(run / "report" / "views.json")["side"] == 1024


def test_pictures_of_another_size_are_rendered_again(finished: Run) -> None:
    directory = RunDirectory(finished.path)
    assert pictures_damage(directory, 1024) is None
    assert pictures_damage(directory, 512) == "report_side was changed"


@pytest.mark.slow
def test_pictures_of_the_report_follow_their_setting(tiny_capture: Path, tmp_path: Path) -> None:
    """Also where every stage is reused."""
    run = tmp_path / "run"
    settings = [word for text in (*QUICK, 'export=["glb"]') for word in ("--set", text)]
    for side in (64, 128):
        words = ("-o", run, "--resume", *settings, "--set", f"report_side={side}")
        assert hir("reconstruct", tiny_capture, *words) == 0
        assert read_json(run / "report" / "views.json")["side"] == side
