"""`hir batch`: invalid arguments, output, and imports at start-up."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path
from types import SimpleNamespace

import pytest

from hir_core.cli import main
from hir_core.config import RunConfig
from hir_core.errors import ConfigError
from hir_plugins.commands.batch.batch_options import BatchOptions
from hir_plugins.commands.batch.command import _interruptible, print_event
from hir_plugins.commands.batch.progress_table import event_sentence, progress_table
from hir_plugins.commands.batch.scheduling import ray_cluster
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.scheduling.driver import Batch
from hir_plugins.commands.batch.scheduling.events import BatchEvent, RunningTask
from hir_plugins.commands.batch.scheduling.messages import ProgressMessage
from tests.fixtures.runs import make_tiny


def hir(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "{tmp}/out"], "no capture was given"),
        (["a/cup", "b/cup", "-o", "{tmp}/out"], "two captures have the name 'cup'"),
        (["{tmp}/out/cup", "-o", "{tmp}/out"], "would replace the capture itself"),
        (["cup"], "Missing option '-o'"),
        (["cup", "-o", "{tmp}/out", "--set", "geometry.iteration=3"], "did you mean 'iterations'?"),
        (["cup", "-o", "{tmp}/out", "--request", "atlas.cpus=1"], "the groups are: initialization, geometry"),
        (["cup", "-o", "{tmp}/out", "--set", "device=cuda"], "no stage group requests a GPU"),
        (["--from", "{tmp}/none.txt", "-o", "{tmp}/out"], "give a file with one capture per line"),
        (["{tmp}/x*", "-o", "{tmp}/out"], "matches nothing"),
        (["cup", "-o", ""], "an address is empty"),
        (["", "-o", "{tmp}/out"], "an address is empty"),
        (["cup", "-o", "s3://"], "s3:// names no folder"),
        (["~nobody-of-this-name/cup", "-o", "{tmp}/out"], "there is no user 'nobody-of-this-name'"),
        (["cup", "-o", "{tmp}/out", "--request", "geometry"], "--request 'geometry': write it as KEY=VALUE"),
        (["cup", "-o", "{tmp}/out", "--address", "127.0.0.1:1", "--attempts", "0"], "Invalid value for '--attempts'"),
    ],
)
def test_invalid_arguments_are_one_sentence(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hir("batch", *(argument.replace("{tmp}", str(tmp_path)) for argument in arguments)) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_missing_ray_is_an_error_and_the_lease_is_released(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert hir("batch", tmp_path / "cup", "-o", tmp_path / "out") == 2
    assert "pip install 'hir[batch]'" in capsys.readouterr().err
    assert not (tmp_path / "out" / ".batch" / "lease.json").exists()


def test_sigterm_interrupts_the_batch_after_ray_was_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray's own handler ends the process with exit code 1, without the sentence that the batch can be continued."""
    ray = SimpleNamespace(
        init=lambda **_: signal.signal(signal.SIGTERM, lambda *_: sys.exit(1)),
        nodes=lambda: [],
        remote=lambda **_: lambda cls: SimpleNamespace(remote=lambda: None),
        shutdown=lambda: None,
    )
    monkeypatch.setitem(sys.modules, "ray", ray)  # type: ignore[arg-type] # as far as the cluster needs it
    monkeypatch.setattr(ray_cluster, "find_spec", lambda name: name)
    cluster = ray_cluster.RayCluster("127.0.0.1:1", lambda message: None)
    with _interruptible(), cluster, pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)


def test_ray_and_storage_libraries_are_imported_only_when_needed() -> None:
    code = (
        "import hir_plugins.commands.batch.scheduling.driver, hir_plugins.commands.batch.scheduling.worker, sys;"
        "import hir_plugins.commands.batch.command, hir_plugins.commands.batch.progress_table;"
        "assert not {'ray', 'fsspec', 's3fs', 'tenacity', 'torch'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_running_cluster_has_an_address_that_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import socket

    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    assert not ray_cluster.running_cluster()
    with socket.create_server(("127.0.0.1", 0)) as server:
        (tmp_path / "ray").mkdir()
        (tmp_path / "ray" / "ray_current_cluster").write_text(f"127.0.0.1:{server.getsockname()[1]}")
        assert ray_cluster.running_cluster()
    assert not ray_cluster.running_cluster(), "the address file is stale"


def test_device_cuda_without_a_gpu_request_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no stage group requests a GPU"):
        Batch(["cup"], str(tmp_path / "out"), BatchOptions(RunConfig(device="cuda")))


def test_events_are_lines_of_json_and_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    events = [
        BatchEvent("message", details={"message": "Ray: one node"}),
        BatchEvent("group_failed", "cup", {"group": "geometry", "reason": "the node left", "retry_in_seconds": 2.0}),
        BatchEvent("capture_finished", "cup", {"psnr": {"object": 31.25}, "warnings": ["thin"]}),
        BatchEvent("progress", "cup", {"step": 1}),
    ]
    for event in events:
        print_event(sys.stdout, event)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["event"] for line in lines] == ["message", "group_failed", "capture_finished", "progress"]
    assert lines[1]["capture"] == "cup" and all(abs(line["time"] - time.time()) < 60 for line in lines)
    assert [event_sentence(event) for event in events] == [
        "Ray: one node",
        "cup: geometry: the node left; retrying in 2 s",
        "cup: done, 31.2 dB, 1 warning",
        "",
    ]


def test_table_shows_tasks_progress_and_remaining_time(tmp_path: Path) -> None:
    from rich.console import Console

    batch = Batch(["cup", "jug", "pot"], str(tmp_path / "out"), BatchOptions(RunConfig()))
    cup, jug, pot = batch.jobs
    cup.state = jug.state = "running"
    cup.group, jug.failures, pot.state = 1, 1, "done"
    batch.state_counts.update({"waiting": -3, "running": 2, "done": 1})
    for group, seconds in enumerate((2.0, 10.0, 30.0, 4.0)):
        batch.estimate.record(group, seconds)
    batch.usage = {"CPU": (2.0, 8.0)}
    progress = ProgressMessage("cup", 1, 1, "node-7", os.getpid(), "geometry", 50, 100)
    batch.running = {1: RunningTask(cup, 100.0, progress), 2: RunningTask(jug, 101.0)}
    console = Console(width=140, file=open(os.devnull, "w"), record=True)  # noqa: SIM115 - closed with the console
    console.print(progress_table(batch, now=104.0))
    text = console.export_text()
    assert "1 of 3 done" in text and "CPU 2 of 8" in text
    (row,) = [line for line in text.splitlines() if "cup" in line]
    assert row.split()[:2] == ["cup", "geometry"] and "50%" in row and "40 s" in row and "node-7" in row
    assert "initialization (attempt 2)" in text and "queued" in text


def test_plain_output_has_no_table(tmp_path: Path) -> None:
    from hir_plugins.commands.batch.progress_table import BatchTable

    with BatchTable(quiet=True) as table:
        table.event(BatchEvent("message", details={"message": "nothing"}))
        table.update(SimpleNamespace())  # type: ignore[arg-type] # unused without a terminal
    assert CaptureJob("cup", "cup").manifest_entry()["state"] == "waiting"


def processes_with(variable: str) -> list[str]:
    """Command lines of running processes that have `variable`, such as `A=1`, in their environment."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
            if state != "Z" and variable.encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue  # not a process, one that has ended, or another user's
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are found by /proc")
def test_no_process_of_ray_remains_after_a_batch_was_killed(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    capture, mark = make_tiny(tmp_path / "cup"), f"HIR_TEST_BATCH={uuid.uuid4()}"
    name, _, value = mark.partition("=")
    command = [sys.executable, "-m", "hir_core.cli", "batch", capture, "-o", tmp_path / "out", "--address", "local"]
    command += ["--set", "geometry.iterations=100000", "--set", "export=[]", "--set", "geometry.triangles=1500"]
    with subprocess.Popen(command, env=os.environ | {name: value}, stdout=subprocess.DEVNULL) as batch:
        deadline = time.monotonic() + 180
        # the task runs when its worker has the name of the task
        while not any(
            process.startswith("ray::initialization") or "of cup" in process for process in processes_with(mark)
        ):
            assert batch.poll() is None and time.monotonic() < deadline, processes_with(mark)
            time.sleep(0.2)
        assert len(processes_with(mark)) > 4
        batch.kill()
    # an agent of Ray whose parent is dead first reports that to a server, which may be dead, too
    deadline = time.monotonic() + 120
    while (left := processes_with(mark)) and time.monotonic() < deadline:
        time.sleep(0.5)
    assert left == []
