"""What `hir batch` costs beside the runs themselves: `python -m benchmarks.batch.measured`.

Small captures, `hir reconstruct` one after the other against one `hir batch`, wall seconds of whole commands: on one
core, and on two cores with two captures at once. Then a batch of twice as many on two cores, against what the model of
benchmarks/batch/model.py, calibrated on the batch of one core, says of it.
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
from hir_plugins.commands.batch.resource_requests import build_requests
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

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
    """Batches get one thread a task and the priority of single runs; Ray's workers would give way to all others."""
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - so it is called


def run_batch(captures: Sequence[Path], out: Path, cores: int) -> Measured:
    """`hir batch` on a Ray of its own with so many cores."""
    import psutil

    began = time.perf_counter()
    command = [
        "batch",
        *map(str, captures),
        "-o",
        str(out),
        "--address",
        "local",
        "--json",
        "--cache",
        str(out / "cache"),
        "--request",
        "reflectance.memory_gib=1",
        *WORDS,
    ]
    seen: list[dict[str, Any]] = []
    clock: dict[str, tuple[float, float]] = {}
    with subprocess.Popen([*on(cores), *HIR, *command], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        watched = psutil.Process(process.pid)
        for line in process.stdout:
            seen.append(json.loads(line))
            if seen[-1]["event"] in ("batch_started", "capture_finished"):
                times = watched.cpu_times()
                clock[seen[-1]["event"]] = (seen[-1]["time"], times.user + times.system)
    assert process.returncode == 0, process.returncode
    first, last = clock["batch_started"], clock["capture_finished"]
    fresh: dict[str, set[str]] = {group.name: set() for group in STAGE_GROUPS}
    workers = set()
    for event in seen:
        if event["event"] == "group_started" and event["pid"] not in workers:
            workers.add(event["pid"])
            fresh[event["group"]].add(event["capture"])
    entries = json.loads((out / "batch.json").read_text())["captures"]
    return Measured(time.perf_counter() - began, last[0] - first[0], last[1] - first[1], entries, fresh)


def run_singles(captures: Sequence[Path], out: Path, cores: int) -> float:
    """Wall seconds of one `hir reconstruct` after the other, each with as many threads as cores."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(cores)}
    began = time.perf_counter()
    for capture in captures:
        command = [*on(cores), *HIR, "reconstruct", str(capture), "-o", str(out / capture.name), "-q", *WORDS]
        subprocess.run(command, check=True, env=environment)
    return time.perf_counter() - began


def on(cores: int) -> list[str]:
    """Words before a command that keep it on the first cores of this machine."""
    return ["taskset", "-c", ",".join(map(str, sorted(os.sched_getaffinity(0))[:cores]))]


def calibrate(measured: Measured) -> tuple[Load, Overhead]:
    """Seconds of the groups, of a worker's start and of what lies between, from one batch."""
    warm: dict[str, list[float]] = {group.name: [] for group in STAGE_GROUPS}
    between, start = [], []
    for group in STAGE_GROUPS:
        for name, entry in measured.entries.items():
            seconds = entry["seconds"][group.name]
            inside = sum(value for key, value in seconds.items() if key != "wall")
            if name not in measured.fresh[group.name]:
                warm[group.name].append(inside)
                between.append(seconds["wall"] - inside)
    for group in STAGE_GROUPS:
        for name in measured.fresh[group.name]:
            usual = median(warm[group.name] or [0.0]) + median(between)
            start.append(measured.entries[name]["seconds"][group.name]["wall"] - usual)
    tasks = len(STAGE_GROUPS) * len(measured.entries)
    load = Load(tuple(mean(warm[group.name]) for group in STAGE_GROUPS), spread=0.0)
    return load, Overhead(worker_start=mean(start), task=median(between), handling=measured.driver / tasks)


def compare(small: Measured, large: Measured, cores: int) -> list[str]:
    """What the model, calibrated on one batch, says of another: lines of Markdown."""
    load, overhead = calibrate(small)
    count = len(large.entries)
    fleet = Fleet(1, cores, memory_gib=16)
    played = play(count, load, fleet, build_requests(1.0, 0.0, ["reflectance.memory_gib=1"]), overhead)
    groups = ", ".join(f"{seconds:.2f}" for seconds in load.seconds)
    return [
        f"calibrated on {len(small.entries)} captures: groups {groups} s, a worker's start "
        f"{overhead.worker_start:.1f} s, between tasks {overhead.task:.3f} s, driver "
        f"{1000 * overhead.handling:.1f} ms a task",
        f"{count} captures on {cores} cores: measured {large.batch:.1f} s, model {played.seconds:.1f} s "
        f"({played.seconds / large.batch - 1:+.1%})",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=6, help="On one core; twice as many on two.")
    parser.add_argument("--side", type=int, default=64, help="Pixels of the photographs' sides.")
    options = parser.parse_args(arguments)
    alike()
    with tempfile.TemporaryDirectory() as name:
        folder, count = Path(name), options.captures
        shelf = small_captures(folder / "shelf", 2 * count, side=options.side)
        singles = run_singles(shelf[:count], folder / "singles", cores=1)
        batch = run_batch(shelf[:count], folder / "one", cores=1)
        print(
            f"one core, {count} captures: hir reconstruct {singles:.1f} s, hir batch {batch.command:.1f} s, of which "
            f"Ray's start and end {batch.command - batch.batch:.1f} s",
            flush=True,
        )
        print(
            f"a capture: {(batch.command - singles) / count:+.2f} s, without Ray's start and end "
            f"{(batch.batch - singles) / count:+.2f} s",
            flush=True,
        )
        pair = run_singles(shelf[:2], folder / "pair", cores=2)
        both = run_batch(shelf[:2], folder / "both", cores=2)
        print(
            f"two cores, two captures: one after the other {pair:.1f} s, at once {both.command:.1f} s, of which "
            f"Ray's start and end {both.command - both.batch:.1f} s",
            flush=True,
        )
        large = run_batch(shelf, folder / "large", cores=2)
        print("\n".join(compare(batch, large, cores=2)))


if __name__ == "__main__":
    main()
