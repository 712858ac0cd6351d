"""Everything goes wrong at once: `python -m benchmarks.batch.cluster [--captures 12]`, some minutes on two cores.

Three Ray nodes and an S3 on this machine, the store refusing now and then. Of the captures one is broken. A worker is
killed while it works, then the batch itself; the same call goes on; a node leaves. At the end every result is compared
with its single run, byte for byte.
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

from benchmarks.batch.refusing_s3 import refusing_s3
from benchmarks.batch.shelf import WORDS, small_captures

Event = dict[str, Any]
NODES = 3


@dataclass
class Story:
    """What happened."""

    first: list[Event] = field(default_factory=list)
    """Events of the call that was killed."""
    second: list[Event] = field(default_factory=list)
    """Events of the call that went on."""
    third: list[Event] = field(default_factory=list)
    """Events of the same call once more, with nothing left to do."""
    codes: list[int] = field(default_factory=list)
    """Exit codes of the three calls."""
    manifest_after_kill: dict[str, Any] = field(default_factory=dict)
    manifest: dict[str, Any] = field(default_factory=dict)
    refused: int = 0
    """Requests that the store refused."""
    different: list[str] = field(default_factory=list)
    """Captures whose scene or exports differ from their single run's."""
    equal: list[str] = field(default_factory=list)
    page: str = ""
    log: str = ""
    """Of the broken capture."""

    def named(self, name: str, *calls: list[Event]) -> list[Event]:
        return [event for call in calls or (self.first, self.second) for event in call if event["event"] == name]


def tell(folder: Path, captures: int = 12, say: Callable[[str], None] = print) -> Story:
    """Runs the story below an empty folder."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray makes its workers give way to all other programs: on a machine with other work they stand still
    os.environ.setdefault("RAY_worker_niceness", "0")
    os.environ["OMP_NUM_THREADS"] = "1"
    import ray
    from ray.cluster_utils import Cluster

    story = Story()
    shelf = small_captures(folder / "shelf", captures, broken=1)
    with refusing_s3() as store:
        _fill(shelf)
        cluster = Cluster()
        try:
            nodes = [add_node(cluster, num_cpus=1) for _ in range(NODES)]
            say(f"{NODES} nodes at {cluster.address}, S3 at {store.url}, {captures} captures, one of them broken")
            command = [
                sys.executable,
                "-m",
                "hir_core.cli",
                "batch",
                "s3://shelf/*",
                "-o",
                "s3://results/tonight",
                "--address",
                cluster.address,
                "--json",
                "--deterministic",
                "--request",
                "reflectance.memory_gib=1",
                "--cache",
                str(folder / "cache"),
                *WORDS,
            ]
            with _call(command, folder / "first.log") as process:
                _until_killed(process, story.first, captures, say)
            story.codes.append(process.returncode)
            story.manifest_after_kill = json.loads(_fetch("tonight/batch.json"))
            with _call(command, folder / "second.log") as process:
                for event in _events(process, story.second):
                    if event["event"] == "group_started" and len(nodes) == NODES:
                        found = [node for node in nodes[1:] if event["pid"] in workers_of(node)]
                        for node in found:  # none where the worker is the head's
                            say(f"the node leaves on which {event['capture']} is worked on")
                            nodes.remove(node)
                            cluster.remove_node(node, allow_graceful=False)
            story.codes.append(process.returncode)
            with _call(command, folder / "third.log") as process:
                list(_events(process, story.third))
            story.codes.append(process.returncode)
        finally:
            cluster.shutdown()
            ray.shutdown()
        story.refused = store.refused
        story.manifest = json.loads(_fetch("tonight/batch.json"))
        story.page = _fetch("tonight/batch.html").decode()
        (folder / "batch.html").write_text(story.page, encoding="utf-8")
        (folder / "events.json").write_text(json.dumps([story.first, story.second, story.third]), encoding="utf-8")
        story.log = _fetch(f"tonight/.batch/logs/{shelf[-1].name}.log").decode()
        _compare(shelf[:-1], folder, story)
    say(summary(story))
    return story


def add_node(cluster: Any, **options: Any) -> Any:
    """A node of a local cluster; Ray gives one 30 s to begin, which a busy machine may exceed once."""
    for tries in range(3, 0, -1):
        try:
            return cluster.add_node(include_dashboard=False, **options)
        except Exception as error:  # that is its type
            if tries == 1 or "timed out during startup" not in str(error):
                raise
    raise AssertionError


def workers_of(node: Any) -> set[int]:
    """Process ids of all that a local node started."""
    import psutil

    started = [entry.process.pid for entries in node.all_processes.values() for entry in entries]
    return {child.pid for pid in started if psutil.pid_exists(pid) for child in psutil.Process(pid).children(True)}


def summary(story: Story) -> str:
    """A few lines for a person."""
    states = Counter(entry["state"] for entry in story.manifest["captures"].values())
    again = [f"{e['capture']} {e['group']}: {e['reason']}" for e in story.named("group_failed")]
    failed = [f"{name}: {entry['reason']}" for name, entry in story.manifest["captures"].items() if entry["reason"]]
    groups = Counter((e["capture"], e["group"]) for e in story.named("group_finished"))
    return "\n".join(
        [
            f"{dict(states)}; the store refused {story.refused} requests; exit codes {story.codes}",
            f"equal to the single run: {len(story.equal)}, different: {story.different}",
            f"groups finished: {sum(groups.values())}",
            f"more than once: {[g for g, count in groups.items() if count > 1]}",
            "tried again: " + "; ".join(again),
            "failed: " + "; ".join(failed),
        ]
    )


def _until_killed(
    process: subprocess.Popen[str], events: list[Event], captures: int, say: Callable[[str], None]
) -> None:
    """Kills a worker when three captures have begun their second group, the batch when a third of them is done."""
    killed = ""
    for event in _events(process, events):
        started = [e for e in events if e["event"] == "group_started" and e["group"] == "geometry"]
        if not killed and event["event"] == "group_started" and len(started) == 3:
            killed = event["capture"]
            say(f"worker {event['pid']} is killed while it works on {killed}")
            os.kill(event["pid"], signal.SIGKILL)
        done = [e for e in events if e["event"] == "capture_finished"]
        if killed and len(done) >= captures // 3:
            say(f"the batch is killed, {len(done)} captures done")
            process.kill()
            return


def _call(command: Sequence[str], log: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with log.open("w") as errors:  # the process has its own
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment)


def _events(process: subprocess.Popen[str], events: list[Event]) -> Iterator[Event]:
    assert process.stdout is not None
    for line in process.stdout:
        events.append(json.loads(line))
        yield events[-1]


def _fill(shelf: Sequence[Path]) -> None:
    from hir_plugins.commands.batch.storage import object_store
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    filesystem, _ = StoragePath("s3://shelf").open()
    for bucket in ("shelf", "results"):
        filesystem.mkdir(bucket)
    for capture in shelf:
        files = {file.relative_to(capture).as_posix(): file for file in capture.rglob("*") if file.is_file()}
        object_store.upload(files, StoragePath("s3://shelf") / capture.name)


def _fetch(name: str) -> bytes:
    from hir_plugins.commands.batch.storage import object_store
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    content = object_store.read(StoragePath("s3://results") / name)
    assert content is not None, name
    return content


def _compare(shelf: Sequence[Path], folder: Path, story: Story) -> None:
    """Scene and exports of each result against `hir reconstruct` with the same settings and one thread."""
    from benchmarks.batch.shelf import SETTINGS
    from hir_core.pipeline import reconstruct
    from hir_plugins.commands.batch.storage import object_store
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    for capture in shelf:
        result = StoragePath("s3://results/tonight") / capture.name
        listed = object_store.list_files(result)
        single = reconstruct(capture, folder / "single" / capture.name, assignments=SETTINGS, deterministic=True)
        same = bool(listed) and all(
            object_store.read(result / name) == (single.path / name).read_bytes()
            for name in listed
            if name.startswith(("scene/", "exports/"))
        )
        kept = {
            file.relative_to(single.path).as_posix()
            for part in ("scene", "exports")
            for file in (single.path / part).rglob("*")
            if file.is_file()
        }
        (story.equal if same and kept <= set(listed) else story.different).append(capture.name)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=12)
    parser.add_argument("--page", type=Path, help="Where to keep batch.html.")
    options = parser.parse_args(arguments)
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the nodes end with the program
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            story = tell(Path(folder), options.captures)
        except BaseException:
            for log in Path(folder).glob("*.log"):
                print(log.read_text(encoding="utf-8", errors="replace"), file=sys.stderr)
            raise
    if options.page:
        options.page.write_text(story.page, encoding="utf-8")
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
