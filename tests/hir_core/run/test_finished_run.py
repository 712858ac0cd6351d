"""A finished run is opened on the device that computed it, where there is one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch

from hir_core.pipeline import Run
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory


@pytest.mark.parametrize(
    "timings",
    ["no JSON", "{}", "[]", '{"machine": []}', '{"machine": {"device": 1}}', '{"machine": {"device": "cpu"}}'],
)
def test_a_run_whose_device_is_unknown_is_opened_on_the_processor(
    timings: str, finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    run = shutil.copytree(finished.path, tmp_path / "run")
    (run / "timings.json").write_text(timings, encoding="utf-8")
    assert not open_finished_run(RunDirectory(run)).scene.mesh.positions.is_cuda


def test_a_run_of_a_gpu_is_opened_on_the_processor_where_there_is_none(
    finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    run = shutil.copytree(finished.path, tmp_path / "run")
    (run / "timings.json").write_text(json.dumps({"machine": {"device": "cuda"}}), encoding="utf-8")
    assert not open_finished_run(RunDirectory(run)).scene.mesh.positions.is_cuda
