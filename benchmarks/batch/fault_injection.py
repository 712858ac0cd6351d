"""A batch with injected faults: `python -m benchmarks.batch.fault_injection [--captures 12]` (minutes).

Three Ray nodes and an S3 run on this machine; some requests to the store fail, and one capture is broken. A worker is
killed while it computes, then the driver; the same call continues the batch; then a node leaves. At the end every
result is compared with its single run, byte for byte.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.batch.small_captures import SETTINGS_ARGUMENTS, make_small_captures
from benchmarks.batch.unreliable_s3 import unreliable_s3

Event = dict[str, Any]
NODES = 3


@dataclass
class FaultScenario:
    """The events and results of the three calls."""

    first: list[Event] = field(default_factory=list)
    """Events of the call that was killed."""
    second: list[Event] = field(default_factory=list)
    """Events of the call that continued the batch."""
    third: list[Event] = field(default_factory=list)
    """Events of the same call after the batch was finished."""
    codes: list[int] = field(default_factory=list)
    """Exit codes of the three calls."""
    manifest_after_kill: dict[str, Any] = field(default_factory=dict)
    manifest: dict[str, Any] = field(default_factory=dict)
    failed_requests: int = 0
    """Requests to the store that failed."""
    different: list[str] = field(default_factory=list)
    """Captures whose scene or exports differ from those of their single run."""
    equal: list[str] = field(default_factory=list)
    page: str = ""
    log: str = ""
    """Of the broken capture."""

    def named(self, name: str, *calls: list[Event]) -> list[Event]:
        return [event for call in calls or (self.first, self.second) for event in call if event["event"] == name]


def run_fault_scenario(folder: Path, captures: int = 12, on_message: Callable[[str], None] = print) -> FaultScenario:
    """Runs the scenario below an empty folder."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # by default Ray gives its workers a low priority: on a busy machine they would hardly run
    os.environ.setdefault("RAY_worker_niceness", "0")
    os.environ["OMP_NUM_THREADS"] = "1"
    import ray
    from ray.cluster_utils import Cluster

    scenario = FaultScenario()
    sources = make_small_captures(folder / "captures", captures, broken=1)
    with unreliable_s3() as store:
        _fill(sources)
        cluster = Cluster()
        try:
            nodes = [add_node(cluster, num_cpus=1) for _ in range(NODES)]
            on_message(
                f"{NODES} nodes at {cluster.address}, S3 at {store.url}, {captures} captures, one of them broken"
            )
            command = [
                sys.executable,
                "-m",
                "hir_core.cli",
                "batch",
                "s3://captures/*",
                "-o",
                "s3://results/batch",
                "--address",
                cluster.address,
                "--json",
                "--deterministic",
                "--request",
                "reflectance.memory_gib=1",
                "--cache",
                str(folder / "cache"),
                *SETTINGS_ARGUMENTS,
            ]
            with _call(command, folder / "first.log") as process:
                _until_killed(process, scenario.first, captures, on_message)
            scenario.codes.append(process.returncode)
            scenario.manifest_after_kill = json.loads(_fetch("batch/batch.json"))
            with _call(command, folder / "second.log") as process:
                for event in _events(process, scenario.second):
                    if event["event"] == "group_started" and len(nodes) == NODES:
                        found = [node for node in nodes[1:] if event["pid"] in workers_of(node)]
                        for node in found:  # none if the worker belongs to the head node
                            on_message(f"the node that computes {event['capture']} leaves the cluster")
                            nodes.remove(node)
                            cluster.remove_node(node, allow_graceful=False)
            scenario.codes.append(process.returncode)
            with _call(command, folder / "third.log") as process:
                list(_events(process, scenario.third))
            scenario.codes.append(process.returncode)
        finally:
            cluster.shutdown()
            ray.shutdown()
        scenario.failed_requests = store.failures
        scenario.manifest = json.loads(_fetch("batch/batch.json"))
        scenario.page = _fetch("batch/batch.html").decode()
        (folder / "batch.html").write_text(scenario.page, encoding="utf-8")
        (folder / "events.json").write_text(
            json.dumps([scenario.first, scenario.second, scenario.third]), encoding="utf-8"
        )
        scenario.log = _fetch(f"batch/.batch/logs/{sources[-1].name}.log").decode()
        _compare(sources[:-1], folder, scenario)
    on_message(summary(scenario))
    return scenario


def add_node(cluster: Any, **options: Any) -> Any:
    """Adds a node to a local cluster; a busy machine may exceed Ray's limit of 30 s for its start once."""
    for tries in range(3, 0, -1):
        try:
            return cluster.add_node(include_dashboard=False, **options)
        except Exception as error:  # that is its type
            if tries == 1 or "timed out during startup" not in str(error):
                raise
    raise AssertionError


def workers_of(node: Any) -> set[int]:
    """The process ids of the workers of a local node."""
    import psutil

    started = [entry.process.pid for entries in node.all_processes.values() for entry in entries]
    return {child.pid for pid in started if psutil.pid_exists(pid) for child in psutil.Process(pid).children(True)}


def summary(scenario: FaultScenario) -> str:
    """The result as text."""
    states = Counter(entry["state"] for entry in scenario.manifest["captures"].values())
    retried = [f"{e['capture']} {e['group']}: {e['reason']}" for e in scenario.named("group_failed")]
    failed = [f"{name}: {entry['reason']}" for name, entry in scenario.manifest["captures"].items() if entry["reason"]]
    groups = Counter((e["capture"], e["group"]) for e in scenario.named("group_finished"))
    return "\n".join(
        [
            f"{dict(states)}; {scenario.failed_requests} requests to the store failed; exit codes {scenario.codes}",
            f"equal to the single run: {len(scenario.equal)}, different: {scenario.different}",
            f"groups finished: {sum(groups.values())}",
            f"more than once: {[g for g, count in groups.items() if count > 1]}",
            "retried: " + "; ".join(retried),
            "failed: " + "; ".join(failed),
        ]
    )


def _until_killed(
    process: subprocess.Popen[str], events: list[Event], captures: int, on_message: Callable[[str], None]
) -> None:
    """Kills a worker when three captures are in their second group, and the driver when a third of them is done."""
    killed = ""
    for event in _events(process, events):
        started = [e for e in events if e["event"] == "group_started" and e["group"] == "geometry"]
        if not killed and event["event"] == "group_started" and len(started) == 3:
            killed = event["capture"]
            on_message(f"worker {event['pid']} is killed while it computes {killed}")
            os.kill(event["pid"], signal.SIGKILL)
        done = [e for e in events if e["event"] == "capture_finished"]
        if killed and len(done) >= captures // 3:
            on_message(f"the driver is killed, {len(done)} captures are done")
            process.kill()
            return


def _call(command: Sequence[str], log: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with log.open("w") as errors:  # the process has its own file descriptor
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment)


def _events(process: subprocess.Popen[str], events: list[Event]) -> Iterator[Event]:
    assert process.stdout is not None
    for line in process.stdout:
        events.append(json.loads(line))
        yield events[-1]


def _fill(sources: Sequence[Path]) -> None:
    from hir_plugins.commands.batch.storage import object_store
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    filesystem, _ = StoragePath("s3://captures").open()
    for bucket in ("captures", "results"):
        filesystem.mkdir(bucket)
    for capture in sources:
        files = {file.relative_to(capture).as_posix(): file for file in capture.rglob("*") if file.is_file()}
        object_store.upload(files, StoragePath("s3://captures") / capture.name)


def _fetch(name: str) -> bytes:
    from hir_plugins.commands.batch.storage import object_store
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    content = object_store.read(StoragePath("s3://results") / name)
    assert content is not None, name
    return content


def _compare(sources: Sequence[Path], folder: Path, scenario: FaultScenario) -> None:
    """Scene and exports of each result against `hir reconstruct` with the same settings and one thread."""
    from benchmarks.batch.small_captures import SETTINGS
    from hir_core.pipeline import reconstruct
    from hir_plugins.commands.batch.storage import object_store
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    for capture in sources:
        result = StoragePath("s3://results/batch") / capture.name
        listed = object_store.list_files(result)
        single = reconstruct(capture, folder / "single" / capture.name, assignments=SETTINGS, deterministic=True)
        same = bool(listed) and all(
            object_store.read(result / name) == (single.path / name).read_bytes()
            for name in listed
            if name.startswith(("scene/", "exports/"))
        )
        expected = {
            file.relative_to(single.path).as_posix()
            for part in ("scene", "exports")
            for file in (single.path / part).rglob("*")
            if file.is_file()
        }
        (scenario.equal if same and expected <= set(listed) else scenario.different).append(capture.name)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=12)
    parser.add_argument("--page", type=Path, help="Where to store batch.html.")
    options = parser.parse_args(arguments)
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the nodes with the program
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            scenario = run_fault_scenario(Path(folder), options.captures)
        except BaseException:
            for log in Path(folder).glob("*.log"):
                print(log.read_text(encoding="utf-8", errors="replace"), file=sys.stderr)
            raise
    if options.page:
        options.page.write_text(scenario.page, encoding="utf-8")
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
