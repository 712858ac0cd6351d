"""What `hir batch` costs beside the runs themselves: `python -m benchmarks.batch.measured`.

Small captures, `hir reconstruct` one after the other against one `hir batch`, wall seconds of whole commands: on one
core, and on two cores with two captures at once. `check` compares local batches with benchmarks/batch/model.py.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean, median
from typing import Any

from benchmarks.batch.model import Fleet, Load, Overhead, play
from benchmarks.batch.shelf import WORDS, small_captures
from hir_core.batch.groups import GROUPS, build_requests

HIR = [sys.executable, "-m", "hir_core.cli"]


@dataclass
class Measured:
    """One local batch."""

    command: float
    """Wall seconds of the whole command, with the start of Ray."""
    batch: float
    """Of the batch alone: from its first event to its last."""
    driver: float
    """Processor seconds of the driver during the batch."""
    entries: dict[str, Any] = field(default_factory=dict)
    fresh: dict[str, set[str]] = field(default_factory=dict)
    """For each group the captures whose task was the first of its worker's process."""


def alike() -> None:
    """Batches and single runs get one thread and the same priority; Ray's workers would give way to all others."""
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - so it is called


def run_batch(captures: Sequence[Path], out: Path, cores: int) -> Measured:
    """`hir batch` on a Ray of its own with so many cores."""
    import psutil

    began = time.perf_counter()
    command = ["batch", *map(str, captures), "-o", str(out), "--address", "local", "--json", "--cache",
               str(out / "cache"), "--request", "reflectance.memory_gib=1", *WORDS]  # fmt: skip
    seen: list[dict[str, Any]] = []
    clock: dict[str, tuple[float, float]] = {}
    affinity = ["taskset", "-c", ",".join(map(str, sorted(os.sched_getaffinity(0))[:cores]))]
    with subprocess.Popen([*affinity, *HIR, *command], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        watched = psutil.Process(process.pid)
        for line in process.stdout:
            seen.append(json.loads(line))
            if seen[-1]["event"] in ("batch_started", "capture_finished"):
                times = watched.cpu_times()
                clock[seen[-1]["event"]] = (seen[-1]["time"], times.user + times.system)
    assert process.returncode == 0, process.returncode
    first, last = clock["batch_started"], clock["capture_finished"]
    fresh: dict[str, set[str]] = {group.name: set() for group in GROUPS}
    workers = set()
    for event in seen:
        if event["event"] == "group_started" and event["pid"] not in workers:
            workers.add(event["pid"])
            fresh[event["group"]].add(event["capture"])
    entries = json.loads((out / "batch.json").read_text())["captures"]
    return Measured(time.perf_counter() - began, last[0] - first[0], last[1] - first[1], entries, fresh)


def run_singles(captures: Sequence[Path], out: Path) -> float:
    """Wall seconds of one `hir reconstruct` after the other."""
    began = time.perf_counter()
    for capture in captures:
        subprocess.run([*HIR, "reconstruct", str(capture), "-o", str(out / capture.name), "-q", *WORDS], check=True)
    return time.perf_counter() - began


def calibrate(measured: Measured) -> tuple[Load, Overhead]:
    """Seconds of the groups, of a worker's start and of what lies between, from one batch."""
    warm: dict[str, list[float]] = {group.name: [] for group in GROUPS}
    between, start = [], []
    for group in GROUPS:
        for name, entry in measured.entries.items():
            seconds = entry["seconds"][group.name]
            inside = sum(value for key, value in seconds.items() if key != "wall")
            if name not in measured.fresh[group.name]:
                warm[group.name].append(inside)
                between.append(seconds["wall"] - inside)
    for group in GROUPS:
        for name in measured.fresh[group.name]:
            usual = median(warm[group.name] or [0.0]) + median(between)
            start.append(measured.entries[name]["seconds"][group.name]["wall"] - usual)
    tasks = len(GROUPS) * len(measured.entries)
    load = Load(tuple(mean(warm[group.name]) for group in GROUPS), spread=0.0)
    return load, Overhead(worker_start=mean(start), task=median(between), handling=measured.driver / tasks)


def check(small: int = 4, large: int = 12, cores: int = 2) -> list[str]:
    """A small batch calibrates the model, which then says how long a large one takes: lines of Markdown."""
    alike()
    with tempfile.TemporaryDirectory() as folder:
        shelf = small_captures(Path(folder) / "shelf", large)
        load, overhead = calibrate(run_batch(shelf[:small], Path(folder) / "small", cores))
        measured = run_batch(shelf, Path(folder) / "large", cores)
    fleet = Fleet(1, cores, memory_gib=16)
    played = play(large, load, fleet, build_requests(1.0, 0.0, ["reflectance.memory_gib=1"]), overhead)
    groups = ", ".join(f"{seconds:.2f}" for seconds in load.seconds)
    return [
        f"calibrated on {small} captures: groups {groups} s, a worker's start {overhead.worker_start:.1f} s, "
        f"between tasks {overhead.task:.3f} s, driver {1000 * overhead.handling:.1f} ms a task",
        "",
        "| captures | cores | measured | model | difference |",
        "|---|---|---|---|---|",
        f"| {large} | {cores} | {measured.batch:.1f} s | {played.seconds:.1f} s | "
        f"{played.seconds / measured.batch - 1:+.1%} |",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=6, help="On one core; two more are worked on at once.")
    parser.add_argument("--side", type=int, default=64)
    options = parser.parse_args(arguments)
    alike()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shelf = small_captures(folder / "shelf", options.captures, side=options.side)
        singles = run_singles(shelf, folder / "singles")
        batch = run_batch(shelf, folder / "one", cores=1)
        count = len(shelf)
        print(f"one core, {count} captures: hir reconstruct {singles:.1f} s, hir batch {batch.command:.1f} s, of which "
              f"Ray's start and end {batch.command - batch.batch:.1f} s")  # fmt: skip
        print(f"a capture: {(batch.command - singles) / count:+.2f} s, without Ray's start and end "
              f"{(batch.batch - singles) / count:+.2f} s")  # fmt: skip
        pair = run_singles(shelf[:2], folder / "pair")
        both = run_batch(shelf[:2], folder / "both", cores=2)
        print(f"two cores, two captures: one after the other {pair:.1f} s, at once {both.command:.1f} s, of which "
              f"Ray's start and end {both.command - both.batch:.1f} s")  # fmt: skip


if __name__ == "__main__":
    main()
