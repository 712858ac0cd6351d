"""The overhead of `hir batch` compared with single runs: `python -m benchmarks.batch.overhead`.

Small captures are reconstructed by `hir reconstruct` one after the other and by one `hir batch`, on one core, and on
two cores with two captures at the same time; all times are wall-clock seconds of whole commands. Then a batch of twice
as many captures on two cores is compared with the prediction of benchmarks/batch/simulation.py, calibrated on the
batch on one core.
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

from benchmarks.batch.simulation import CaptureLoad, Fleet, Overhead, simulate
from benchmarks.batch.small_captures import SETTINGS_ARGUMENTS, make_small_captures
from hir_plugins.commands.batch.resource_requests import build_requests
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

HIR = [sys.executable, "-m", "hir_core.cli"]


@dataclass
class MeasuredBatch:
    """One local batch."""

    command: float
    """Wall-clock seconds of the whole command, including the start of Ray."""
    batch: float
    """Seconds from the first event of the batch to its last."""
    driver: float
    """CPU seconds of the driver during the batch."""
    entries: dict[str, Any] = field(default_factory=dict)
    first_tasks: dict[str, set[str]] = field(default_factory=dict)
    """For each stage group, the captures whose task was the first one of its worker process."""


def equalize_conditions() -> None:
    """Gives the tasks of batches one thread and the priority of single runs; Ray's default priority is lower."""
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - the name that Ray reads


def run_batch(captures: Sequence[Path], out: Path, cores: int) -> MeasuredBatch:
    """`hir batch` on a local Ray cluster with `cores` cores."""
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
        *SETTINGS_ARGUMENTS,
    ]
    events: list[dict[str, Any]] = []
    clock: dict[str, tuple[float, float]] = {}
    with subprocess.Popen([*pin_to_cores(cores), *HIR, *command], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        driver = psutil.Process(process.pid)
        for line in process.stdout:
            events.append(json.loads(line))
            if events[-1]["event"] in ("batch_started", "capture_finished"):
                times = driver.cpu_times()
                clock[events[-1]["event"]] = (events[-1]["time"], times.user + times.system)
    assert process.returncode == 0, process.returncode
    first, last = clock["batch_started"], clock["capture_finished"]
    first_tasks: dict[str, set[str]] = {group.name: set() for group in STAGE_GROUPS}
    workers = set()
    for event in events:
        if event["event"] == "group_started" and event["pid"] not in workers:
            workers.add(event["pid"])
            first_tasks[event["group"]].add(event["capture"])
    entries = json.loads((out / "batch.json").read_text())["captures"]
    return MeasuredBatch(time.perf_counter() - began, last[0] - first[0], last[1] - first[1], entries, first_tasks)


def run_singles(captures: Sequence[Path], out: Path, cores: int) -> float:
    """Wall-clock seconds of `hir reconstruct` for one capture after the other, each with as many threads as cores."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(cores)}
    began = time.perf_counter()
    for capture in captures:
        command = [
            *pin_to_cores(cores),
            *HIR,
            "reconstruct",
            str(capture),
            "-o",
            str(out / capture.name),
            "-q",
            *SETTINGS_ARGUMENTS,
        ]
        subprocess.run(command, check=True, env=environment)
    return time.perf_counter() - began


def pin_to_cores(cores: int) -> list[str]:
    """The prefix that restricts a command to the first cores of this machine."""
    return ["taskset", "-c", ",".join(map(str, sorted(os.sched_getaffinity(0))[:cores]))]


def calibrate(measured: MeasuredBatch) -> tuple[CaptureLoad, Overhead]:
    """The seconds of the groups, of a worker's start and of the overhead between tasks, from one batch."""
    later_tasks: dict[str, list[float]] = {group.name: [] for group in STAGE_GROUPS}
    between, start = [], []
    for group in STAGE_GROUPS:
        for name, entry in measured.entries.items():
            seconds = entry["seconds"][group.name]
            inside = sum(value for key, value in seconds.items() if key != "wall")
            if name not in measured.first_tasks[group.name]:
                later_tasks[group.name].append(inside)
                between.append(seconds["wall"] - inside)
    for group in STAGE_GROUPS:
        for name in measured.first_tasks[group.name]:
            usual = median(later_tasks[group.name] or [0.0]) + median(between)
            start.append(measured.entries[name]["seconds"][group.name]["wall"] - usual)
    tasks = len(STAGE_GROUPS) * len(measured.entries)
    load = CaptureLoad(tuple(mean(later_tasks[group.name]) for group in STAGE_GROUPS), log_std=0.0)
    return load, Overhead(worker_start=mean(start), task=median(between), handling=measured.driver / tasks)


def compare(small: MeasuredBatch, large: MeasuredBatch, cores: int) -> list[str]:
    """The prediction for one batch, calibrated on another, beside its measurement: lines of Markdown."""
    load, overhead = calibrate(small)
    count = len(large.entries)
    fleet = Fleet(1, cores, memory_gib=16)
    simulated = simulate(count, load, fleet, build_requests(1.0, 0.0, ["reflectance.memory_gib=1"]), overhead)
    groups = ", ".join(f"{seconds:.2f}" for seconds in load.seconds)
    return [
        f"calibrated on {len(small.entries)} captures: groups {groups} s, a worker's start "
        f"{overhead.worker_start:.1f} s, between tasks {overhead.task:.3f} s, driver "
        f"{1000 * overhead.handling:.1f} ms a task",
        f"{count} captures on {cores} cores: measured {large.batch:.1f} s, simulation {simulated.seconds:.1f} s "
        f"({simulated.seconds / large.batch - 1:+.1%})",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=6, help="On one core; twice as many on two.")
    parser.add_argument("--side", type=int, default=64, help="Pixels of the photographs' sides.")
    options = parser.parse_args(arguments)
    equalize_conditions()
    with tempfile.TemporaryDirectory() as name:
        folder, count = Path(name), options.captures
        captures = make_small_captures(folder / "captures", 2 * count, side=options.side)
        singles = run_singles(captures[:count], folder / "singles", cores=1)
        batch = run_batch(captures[:count], folder / "one", cores=1)
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
        pair = run_singles(captures[:2], folder / "pair", cores=2)
        both = run_batch(captures[:2], folder / "both", cores=2)
        print(
            f"two cores, two captures: one after the other {pair:.1f} s, at once {both.command:.1f} s, of which "
            f"Ray's start and end {both.command - both.batch:.1f} s",
            flush=True,
        )
        large = run_batch(captures, folder / "large", cores=2)
        print("\n".join(compare(batch, large, cores=2)))


if __name__ == "__main__":
    main()
