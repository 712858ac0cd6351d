"""`hir reconstruct` of a run that is there already, and `hir render` of it, as a person types them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from hir_core.pipeline import Run
from hir_core.terminal.run_results import decisions
from tests.fixtures.command_line import hir
from tests.fixtures.runs import QUICK


def test_a_finished_run_is_reused_and_its_files_are_printed(
    finished: Run, tiny_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    settings = [word for assignment in QUICK for word in ("--set", assignment)]
    arguments = [
        "reconstruct",
        tiny_capture,
        "-o",
        tmp_path / "run",
        *settings,
        "--triangles",
        "1500",
        "--texture-size",
        "64",
        "--device",
        "cpu",
        "--deterministic",
        "--resume",
    ]
    assert hir(*arguments) == 0
    message = capsys.readouterr()
    stages = ("initializer", "geometry", "atlas", "reflectance", "bake", "export")
    assert all(f"{stage}: reused" in message.err for stage in stages), message.err
    output = message.out.splitlines()
    assert [line.split()[0] for line in output[:3]] == ["asset", "files", "report"]
    assert {line.split()[0] for line in output[3:]} == {p.name for p in finished.directory.exports.iterdir()}
    assert hir(*arguments, "-q") == 0
    assert capsys.readouterr().out == ""


def test_the_explanation_is_printed_where_hypotheses_were_compared() -> None:
    sentence = "metal, light in the world; next: dielectric, 3.1 ± 0.4 dB worse"
    document = {"stages": {"reflectance": {"report": {"explanation": {"sentence": sentence}}}}}
    assert decisions(document)["model"] == sentence
    assert decisions({"stages": {"reflectance": {"report": None}}}) == {}
    assert decisions({"stages": {}}) == {}


def test_pictures_around_a_run(finished: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("render", finished.path, "--orbit", "2", "--size", "16", "--set", "render_samples=2", "-o", tmp_path)
    assert hir(*arguments) == 0
    output = capsys.readouterr().out.splitlines()
    assert [Path(line).name for line in output] == ["orbit_000.png", "orbit_001.png"]
    assert all(Path(line).is_file() for line in output)
    assert hir(*arguments, "-q") == 0 and capsys.readouterr().out == ""
