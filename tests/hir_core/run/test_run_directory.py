"""A run's folder: records, keys, the lock, and what is refused."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hir_core.errors import InputError, StageError
from hir_core.files.json_documents import jsonable
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory, StageRecord, claimed_run, open_run


def test_stage_folders_are_numbered_in_the_order_of_a_run(tmp_path: Path) -> None:
    names = [RunDirectory(tmp_path).stage(name).name for name in STAGE_NAMES]
    assert names == ["1-initializer", "2-geometry", "3-atlas", "4-reflectance", "5-bake", "6-export"]


def test_unfinished_stage_keeps_its_workspace_and_a_changed_key_empties_it(tmp_path: Path) -> None:
    run = RunDirectory(tmp_path)
    (run.begin("geometry", "one") / "checkpoint").write_text("step 100")
    assert (run.begin("geometry", "one") / "checkpoint").exists()
    assert not (run.begin("geometry", "two") / "checkpoint").exists()
    record = run.record("geometry")
    assert record is not None and record.key == "two" and not record.finished
    run.finish(StageRecord("geometry", "two", True, {"iou": 0.99}, ("thin parts",)))
    assert run.record("geometry") == StageRecord("geometry", "two", True, {"iou": 0.99}, ("thin parts",))


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"key": 1}', "\xff", '{"key":"k","finished":true,"report":3,"warnings":[]}']
)
def test_damaged_record_is_no_record(tmp_path: Path, text: str) -> None:
    run = RunDirectory(tmp_path)
    run.begin("atlas", "one")
    (run.stage("atlas") / "stage.json").write_bytes(text.encode("latin-1"))
    assert run.record("atlas") is None


def test_folder_with_other_things_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match=r"thesis\.tex"), claimed_run(tmp_path, resume=True):
        pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["thesis.tex"]


def test_run_is_not_overwritten_unless_resumed(tmp_path: Path) -> None:
    with claimed_run(tmp_path / "run", resume=False) as run:
        run.write_run({})
    with pytest.raises(InputError, match="--resume"), claimed_run(tmp_path / "run", resume=False):
        pass
    with claimed_run(tmp_path / "run", resume=True) as run:
        assert run.read_run()["format"] == "hir-run"


def test_second_process_is_refused_and_a_dead_one_leaves_no_lock(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom hir_core.run.run_directory import claimed_run\n"
        f"with claimed_run({str(tmp_path)!r}, resume=True):\n    print('locked', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"locked\n"
        with pytest.raises(StageError, match="another process"), claimed_run(tmp_path, resume=True):
            pass
        other.kill()
        other.wait()
    with claimed_run(tmp_path, resume=True):
        pass


def test_what_is_not_a_run_is_said_with_the_command_that_makes_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="hir reconstruct"):
        open_run(tmp_path)
    with pytest.raises(InputError, match="hir reconstruct"):
        open_run(tmp_path / "missing")
    (tmp_path / "run.json").write_text(json.dumps({"format": "hir-run", "version": 99}))
    with pytest.raises(InputError, match="version 99"):
        open_run(tmp_path).read_run()


def test_json_of_a_report_holds_no_nan() -> None:
    import numpy as np

    value = {"a": np.float32(np.nan), "b": [np.arange(2), np.inf], "c": (True, None, "x")}
    assert jsonable(value) == {"a": None, "b": [[0, 1], None], "c": [True, None, "x"]}


def test_a_run_of_another_version_is_refused_and_unchanged(tmp_path: Path) -> None:
    text = '{"format": "hir-run", "version": 1}'
    (tmp_path / "run.json").write_text(text)
    with (
        pytest.raises(InputError, match=r"version 1, this program reads 2; reconstruct the capture again"),
        claimed_run(tmp_path, resume=True),
    ):
        pass
    assert (tmp_path / "run.json").read_text() == text
