"""A finished run is opened on the device that computed it, where there is one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from hir_core.errors import InputError
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


@pytest.mark.slow
def test_the_scene_of_an_earlier_fit_is_refused_until_the_run_is_finished_again(
    finished: Run, tiny_capture: Path, tmp_path: Path, quick: Callable[..., Run]
) -> None:
    run = shutil.copytree(finished.path, tmp_path / finished.path.name)
    page = (run / "report.html").read_bytes()
    quick(tiny_capture, run, "atlas.texture_size=32", deterministic=True, resume=True, until="atlas")
    assert (run / "scene").is_dir() and (run / "report.html").read_bytes() == page, "nothing is lost"
    with pytest.raises(InputError, match="scene/ is of an earlier one; finish it with: hir reconstruct"):
        open_finished_run(RunDirectory(run))
    quick(tiny_capture, run, "atlas.texture_size=32", deterministic=True, resume=True)
    material = open_finished_run(RunDirectory(run)).scene.material
    assert material is not None and material.diffuse_albedo.shape[0] == 32
