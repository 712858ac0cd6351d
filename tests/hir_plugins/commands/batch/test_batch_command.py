"""`hir batch`: what it refuses, what it prints, and that it starts light."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from hir_core.cli import main
from hir_core.config import RunConfig
from hir_core.errors import ConfigError
from hir_plugins.commands.batch.batch_options import Options
from hir_plugins.commands.batch.command import print_event
from hir_plugins.commands.batch.progress_table import sentence_of, table_of
from hir_plugins.commands.batch.scheduling import ray_cluster
from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.scheduling.driver import Batch
from hir_plugins.commands.batch.scheduling.events import Event, Running
from hir_plugins.commands.batch.scheduling.messages import Told


def hir(*words: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    assert isinstance(stop.value.code, int)
    return stop.value.code


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "{tmp}/out"], "there is no capture to work on"),
        (["a/cup", "b/cup", "-o", "{tmp}/out"], "two captures are called 'cup'"),
        (["{tmp}/out/cup", "-o", "{tmp}/out"], "would replace the capture itself"),
        (["cup"], "Missing option '-o'"),
        (["cup", "-o", "{tmp}/out", "--set", "geometry.iteration=3"], "did you mean 'iterations'?"),
        (["cup", "-o", "{tmp}/out", "--request", "atlas.cpus=1"], "the groups are: initialization, geometry"),
        (["cup", "-o", "{tmp}/out", "--set", "device=cuda"], "give a share of one with --gpus"),
        (["--from", "{tmp}/none.txt", "-o", "{tmp}/out"], "give a file with one capture a line"),
        (["{tmp}/x*", "-o", "{tmp}/out"], "matches nothing"),
        (["cup", "-o", "{tmp}/out", "--address", "127.0.0.1:1", "--tries", "0"], "Invalid value for '--tries'"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hir("batch", *(word.replace("{tmp}", str(tmp_path)) for word in words)) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_missing_ray_is_named_and_the_lease_given_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_cluster, "find_spec", lambda name: None)
    assert hir("batch", tmp_path / "cup", "-o", tmp_path / "out") == 2
    assert "pip install 'hir[batch]'" in capsys.readouterr().err
    assert not (tmp_path / "out" / ".batch" / "lease.json").exists()


def test_ray_and_stores_are_loaded_when_they_are_needed() -> None:
    code = (
        "import hir_plugins.commands.batch.scheduling.driver, hir_plugins.commands.batch.scheduling.worker, sys;"
        "import hir_plugins.commands.batch.command, hir_plugins.commands.batch.progress_table;"
        "assert not {'ray', 'fsspec', 's3fs', 'torch'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_running_cluster_is_one_that_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import socket

    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    assert not ray_cluster.running_cluster()
    with socket.create_server(("127.0.0.1", 0)) as server:
        (tmp_path / "ray").mkdir()
        (tmp_path / "ray" / "ray_current_cluster").write_text(f"127.0.0.1:{server.getsockname()[1]}")
        assert ray_cluster.running_cluster()
    assert not ray_cluster.running_cluster(), "a note that nobody answers at is stale"


def test_device_that_no_group_may_use_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no group asks for a GPU"):
        Batch(["cup"], str(tmp_path / "out"), Options(RunConfig(device="cuda")))


def test_events_are_lines_of_json_and_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    events = [
        Event("message", facts={"message": "Ray: one node"}),
        Event("group_failed", "cup", {"group": "geometry", "reason": "the node left", "again_in_seconds": 2.0}),
        Event("capture_finished", "cup", {"psnr": {"object": 31.25}, "warnings": ["thin"]}),
        Event("progress", "cup", {"step": 1}),
    ]
    for event in events:
        print_event(sys.stdout, event)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["event"] for line in lines] == ["message", "group_failed", "capture_finished", "progress"]
    assert lines[1]["capture"] == "cup" and all(abs(line["time"] - time.time()) < 60 for line in lines)
    assert [sentence_of(event) for event in events] == [
        "Ray: one node",
        "cup: geometry: the node left; again in 2 s",
        "cup: done, 31.2 dB, 1 warnings",
        "",
    ]


def test_table_shows_who_does_what_and_how_long_it_will_take(tmp_path: Path) -> None:
    from rich.console import Console

    batch = Batch(["cup", "jug", "pot"], str(tmp_path / "out"), Options(RunConfig()))
    cup, jug, pot = batch.chains
    cup.state = jug.state = "running"
    cup.group, jug.failures, pot.state = 1, 1, "done"
    batch.tally.update({"waiting": -3, "running": 2, "done": 1})
    for group, seconds in enumerate((2.0, 10.0, 30.0, 4.0)):
        batch.estimate.learn(group, seconds)
    batch.use = {"CPU": (2.0, 8.0)}
    told = Told("cup", 1, 1, "node-7", os.getpid(), "geometry", 50, 100)
    batch.running = {1: Running(cup, 100.0, told), 2: Running(jug, 101.0)}
    console = Console(width=140, file=open(os.devnull, "w"), record=True)  # noqa: SIM115 - open for as long as its owner
    console.print(table_of(batch, now=104.0))
    shown = console.export_text()
    assert "1 of 3 done" in shown and "CPU 2 of 8" in shown
    (row,) = [line for line in shown.splitlines() if "cup" in line]
    assert row.split()[:2] == ["cup", "geometry"] and "50%" in row and "40 s" in row and "node-7" in row
    assert "initialization (try 2)" in shown and "waits for a place" in shown


def test_plain_output_has_no_table(tmp_path: Path) -> None:
    from hir_plugins.commands.batch.progress_table import BatchTable

    with BatchTable(quiet=True) as table:
        table.event(Event("message", facts={"message": "nothing"}))
        table.update(SimpleNamespace())  # type: ignore[arg-type] # not looked at where there is no terminal
    assert Chain("cup", "cup").entry()["state"] == "waiting"
