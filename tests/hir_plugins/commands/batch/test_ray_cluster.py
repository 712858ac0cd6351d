"""Local Ray clusters: lost workers and nodes, failing requests, broken captures, interrupts."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.batch.fault_injection import FaultScenario, add_node, run_fault_scenario
from benchmarks.batch.small_captures import SETTINGS_ARGUMENTS, make_small_captures

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="signals")]
CAPTURES = 8


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> FaultScenario:
    """Three nodes and an S3; a worker is killed, then the driver; a node leaves while the same call continues."""
    pytest.importorskip("ray", reason="ray is not installed: pip install -e '.[batch]'")
    pytest.importorskip("moto", reason="moto is not installed: pip install -e '.[test]'")
    return run_fault_scenario(tmp_path_factory.mktemp("scenario"), CAPTURES)


def test_all_but_the_broken_capture_equal_their_single_runs(scenario: FaultScenario) -> None:
    assert scenario.different == [] and len(scenario.equal) == CAPTURES - 1
    states = Counter(entry["state"] for entry in scenario.manifest["captures"].values())
    assert states == {"done": CAPTURES - 1, "failed": 1}
    assert scenario.codes == [-signal.SIGKILL, 3, 3]


def test_the_failure_is_one_clear_sentence_with_a_log(scenario: FaultScenario) -> None:
    (failed,) = [entry for entry in scenario.manifest["captures"].values() if entry["state"] == "failed"]
    assert failed["source"].endswith(f"cow{CAPTURES - 1:02}") and failed["retries"] == 0
    assert failed["reason"].startswith("initialization: ") and ".png" in failed["reason"]
    assert "\n" not in failed["reason"] and "Traceback" in scenario.log and failed["reason"] in scenario.log


def test_no_task_is_done_twice(scenario: FaultScenario) -> None:
    finished = Counter((e["capture"], e["group"]) for e in scenario.named("group_finished"))
    assert max(finished.values()) == 1
    before = {e["capture"] for e in scenario.named("capture_finished", scenario.first)}
    after = {e["capture"] for e in scenario.named("group_started", scenario.second)}
    assert before and before.isdisjoint(after), "captures that the killed call finished are not started again"
    assert {e["capture"] for e in scenario.named("capture_skipped", scenario.second)} >= before
    assert not scenario.named("group_started", scenario.third), "the third call finds nothing to do"
    assert len(scenario.named("capture_skipped", scenario.third)) == CAPTURES


def test_lost_worker_and_lost_node_are_retried(scenario: FaultScenario) -> None:
    reasons = [e["reason"] for e in scenario.named("group_failed", scenario.first)]
    assert any("process died" in reason for reason in reasons)
    assert scenario.named("group_failed", scenario.second), "tasks of the lost node are retried"
    assert scenario.failed_requests > 20, "requests to the store failed"


def test_the_manifest_is_complete_after_the_driver_was_killed(scenario: FaultScenario) -> None:
    captures = scenario.manifest_after_kill["captures"]
    assert len(captures) == CAPTURES and any(entry["state"] == "running" for entry in captures.values())


def test_the_page_shows_the_failure_first_and_a_picture_of_each_result(scenario: FaultScenario) -> None:
    rows = scenario.page.split("<tbody>")[1].split("<tr ")[1:]
    assert len(rows) == CAPTURES and rows[0].startswith('class="failed"')
    assert sum("data:image/jpeg" in row for row in rows) == CAPTURES - 1


def test_interrupted_batch_is_finished_by_the_same_call(tmp_path: Path) -> None:
    """The local Ray cluster listens on the loopback interface only and ends with the command."""
    pytest.importorskip("ray", reason="ray is not installed: pip install -e '.[batch]'")
    make_small_captures(tmp_path / "captures", 2)
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "hir_core.cli",
        "batch",
        f"{tmp_path}/captures/*",
        "-o",
        str(out),
        "--json",
        "--address",
        "local",
        "--cache",
        str(tmp_path / "cache"),
        *SETTINGS_ARGUMENTS,
    ]
    events = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            events.append(json.loads(line))
            if events[-1]["event"] == "group_finished":
                assert foreign_listeners(process.pid) == []
                process.send_signal(signal.SIGINT)
                break
        events += [json.loads(line) for line in process.stdout]
        assert process.wait(timeout=120) == 130
        assert "repeat the call to continue" in process.stderr.read()
    workers = {event["pid"] for event in events if event["event"] == "group_started"}
    until = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < until:
        time.sleep(0.2)
    assert workers and not any(Path(f"/proc/{pid}").exists() for pid in workers)
    captures = json.loads((out / "batch.json").read_text())["captures"]
    assert {entry["state"] for entry in captures.values()} == {"waiting"}
    assert not (out / ".batch" / "lease.json").exists()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    again = [json.loads(line) for line in done.stdout.splitlines()]
    finished = [(e["capture"], e["group"]) for e in events + again if e["event"] == "group_finished"]
    assert len(finished) == len(set(finished)), "no task is done twice"
    captures = json.loads((out / "batch.json").read_text())["captures"]
    assert {entry["state"] for entry in captures.values()} == {"done"}
    assert (out / "cow00" / "report.html").exists() and (out / "batch.html").exists()


def foreign_listeners(parent: int) -> list[str]:
    """Addresses other than the loopback interface on which a process or its descendants listen."""
    import psutil

    family = [psutil.Process(parent), *psutil.Process(parent).children(recursive=True)]
    found = []
    for process in family:
        for connection in process.net_connections(kind="tcp"):
            address = connection.laddr.ip.removeprefix("::ffff:") if connection.laddr else ""
            if connection.status == psutil.CONN_LISTEN and address not in ("127.0.0.1", "::1"):
                found.append(f"{process.name()} {address}:{connection.laddr.port}")
    return found


def test_tasks_on_a_gpu_have_processes_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through Ray's client, on a node that declares a GPU: CUDA keeps the device that a process used first."""
    pytest.importorskip("ray", reason="ray is not installed: pip install -e '.[batch]'")
    from ray.cluster_utils import Cluster

    # the client's server starts a process for each client; gRPC's handlers of fork() end or block it
    monkeypatch.setenv("GRPC_ENABLE_FORK_SUPPORT", "0")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    make_small_captures(tmp_path / "captures", 2)
    cluster = Cluster()
    try:
        add_node(cluster, num_cpus=2, num_gpus=1, ray_client_server_port=port)
        command = [
            sys.executable,
            "-m",
            "hir_core.cli",
            "batch",
            f"{tmp_path}/captures/*",
            "-o",
            str(tmp_path / "out"),
            "--json",
            "--gpus",
            "0.5",
            "--address",
            f"ray://127.0.0.1:{port}",
            "--cache",
            str(tmp_path / "cache"),
            *SETTINGS_ARGUMENTS,
            "--set",
            "device=auto",
        ]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, timeout=600)
    finally:
        cluster.shutdown()
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert "1 GPUs" in next(event["message"] for event in events if event["event"] == "message")
    started = [event for event in events if event["event"] == "group_started"]
    with_gpu = [event["pid"] for event in started if event["group"] in ("geometry", "reflectance")]
    without = {event["pid"] for event in started} - set(with_gpu)
    assert len(with_gpu) == len(set(with_gpu)) == 4, "one process for each task"
    assert 1 <= len(without) <= 2, "the CPU tasks share workers"
    assert sum(event["event"] == "capture_finished" for event in events) == 2
