"""Simulates the time and the cost of large batches: captures, nodes, driver and store.

    python -m benchmarks.batch.simulation            # 10³ and 10⁶ captures on fleets, from measured stage seconds
    python -m benchmarks.batch.overhead              # local batches compared with their simulation

The simulation implements the rules of `hir batch`: stage groups, resource requests, the number of captures in progress,
one driver that handles one outcome at a time and rewrites its manifest. It simulates every task, with varying durations
and with workers that are lost. It does not assign tasks to nodes: a fleet is one pool of cores, GPUs and memory.
"""

from __future__ import annotations

import argparse
import heapq
import math
import random
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from hir_plugins.commands.batch.cluster_capacity import max_captures_in_progress
from hir_plugins.commands.batch.resource_requests import ResourceRequests, build_requests
from hir_plugins.commands.batch.retries import RetryPolicy
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

GIB = 2.0**30


@dataclass(frozen=True)
class CaptureLoad:
    """One capture: seconds of each stage group on one core, and bytes transferred."""

    seconds: tuple[float, ...]
    log_std: float = 0.25
    """Standard deviation of the logarithm of a capture's seconds, the same factor for all its groups."""
    bytes_in: float = 17e6
    bytes_out: float = 45e6
    """The result, and the stages that are stored for the next task."""
    requests_of_store: float = 200.0


@dataclass(frozen=True)
class Fleet:
    """Nodes of one kind."""

    nodes: int
    cpus: float
    gpus: float = 0.0
    memory_gib: float = 64.0
    dollars_per_hour: float = 0.0
    """Of one node."""
    lost_hours: float = math.inf
    """Mean hours until a node is lost, as spot machines are."""

    @property
    def resources(self) -> list[Mapping[str, float]]:
        return [{"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * GIB}] * self.nodes


@dataclass(frozen=True)
class Overhead:
    """Seconds in which no stage computes, measured by benchmarks.batch.overhead (docs/scaling.md)."""

    worker_start: float = 7.4
    """Until a new worker process has imported its libraries."""
    task: float = 0.63
    """From submission to outcome, without the stages: Ray, staging, storing."""
    handling: float = 0.022
    """Of the driver, for each task."""
    entry: float = 2.4e-5
    """Of the driver, for each capture, whenever it writes the manifest."""
    tasks_per_worker: int = 64


@dataclass
class SimulationResult:
    """The result of a simulation."""

    seconds: float = 0.0
    busy: dict[str, float] = field(default_factory=dict)
    """Fraction of the CPU and GPU time that tasks reserved."""
    driver: float = 0.0
    """Fraction of the time in which the driver was busy."""
    lost: int = 0
    """Tasks that were lost and retried."""
    longest_wait: float = 0.0
    """The longest time that an outcome waited for the driver, in seconds."""


def simulate(
    captures: int,
    load: CaptureLoad,
    fleet: Fleet,
    requests: ResourceRequests,
    overhead: Overhead = Overhead(),
    seed: int = 0,
    listed: int = 0,
) -> SimulationResult:
    """Simulates a batch; `listed` is the number of captures in the manifest, by default the simulated ones."""
    generator = random.Random(seed)
    group_requests = [requests.of(group) for group in STAGE_GROUPS]
    needs = [{name: amount for name, amount in request.resources().items() if amount > 0} for request in group_requests]
    free = {name: sum(node[name] for node in fleet.resources) for name in ("CPU", "GPU", "memory")}
    total = dict(free)
    max_in_progress = max_captures_in_progress(fleet.resources, requests)
    unstarted_workers = max_in_progress
    policy = RetryPolicy(3, initial_wait_s=2.0, factor=4.0)
    result = SimulationResult(busy={"CPU": 0.0, "GPU": 0.0})
    waiting: list[deque[float]] = [deque() for _ in STAGE_GROUPS]
    """The duration factors of the captures that wait for their next group."""
    events: list[tuple[float, int, str, int, float]] = []  # time, order, kind, group, duration factor
    driver_free = manifest_due = now = 0.0
    started = done = order = running = 0

    def schedule(time: float, kind: str, group: int, factor: float) -> None:
        nonlocal order
        order += 1
        heapq.heappush(events, (time, order, kind, group, factor))

    def start(time: float, group: int, factor: float) -> None:
        nonlocal running, unstarted_workers
        for name, amount in needs[group].items():
            free[name] -= amount
        seconds = load.seconds[group] * factor / group_requests[group].threads + overhead.task
        if group_requests[group].gpus > 0:
            seconds += overhead.worker_start  # each GPU task has a process of its own
        elif unstarted_workers > 0 or generator.random() < 1 / overhead.tasks_per_worker:
            unstarted_workers -= 1
            seconds += overhead.worker_start
        lost = generator.random() < 1 - math.exp(-seconds / 3600 / fleet.lost_hours)
        if lost:
            seconds *= generator.random()
        for name in ("CPU", "GPU"):
            result.busy[name] += needs[group].get(name, 0.0) * seconds
        running += 1
        schedule(time + seconds, "lost" if lost else "done", group, factor)

    def submit(time: float) -> None:
        """Starts the tasks that fit, later groups first. As in Ray, a task that waits for a GPU blocks no other."""
        nonlocal started
        for group in reversed(range(len(STAGE_GROUPS))):
            while waiting[group] and all(free[k] + 1e-9 >= v for k, v in needs[group].items()):
                start(time, group, waiting[group].popleft())
        while started < captures and running + sum(map(len, waiting)) < max_in_progress:
            factor = math.exp(generator.gauss(0.0, load.log_std))
            started += 1
            waiting[0].append(factor)
            if all(free[k] + 1e-9 >= v for k, v in needs[0].items()):
                start(time, 0, waiting[0].popleft())

    submit(0.0)
    while done < captures:
        now, _, kind, group, factor = heapq.heappop(events)
        if kind == "retry":
            waiting[group].append(factor)
            submit(now)
            continue
        running -= 1
        for name, amount in needs[group].items():
            free[name] += amount
        handled = max(now, driver_free)
        if handled >= manifest_due:
            written = (listed or captures) * overhead.entry
            result.driver += written
            handled += written
            manifest_due = handled + max(1.0, written / 0.05)
        handled += overhead.handling
        result.driver += overhead.handling
        result.longest_wait = max(result.longest_wait, handled - now)
        driver_free = handled
        if kind == "lost":
            result.lost += 1
            schedule(handled + policy.wait_s(1), "retry", group, factor)
        elif group + 1 < len(STAGE_GROUPS):
            waiting[group + 1].append(factor)
        else:
            done += 1
        submit(handled)
    result.seconds = max(now, driver_free)
    result.driver /= result.seconds
    for name in result.busy:
        result.busy[name] = result.busy[name] / (total[name] * result.seconds) if total[name] else 0.0
    return result


MAX_SIMULATED = 100_000
"""Of a larger batch so many captures are simulated, with the manifest of all, and the time is scaled."""

MEASURED_SECONDS = {
    "spot": (10.5, 74.3, 234.4, 4.9),
    "avocado": (10.3, 69.4, 241.1, 4.8),
    "chair": (11.3, 128.4, 273.3, 6.9),
}
"""Seconds of the four groups with preset `fast`, measured on one core of an AMD EPYC (Zen 4); docs/benchmarks.md."""

FLEETS = (
    ("laptop, 8 cores", 1_000, Fleet(1, 8, memory_gib=32)),
    ("workstation, 64 cores", 1_000, Fleet(1, 64, memory_gib=256)),
    ("cluster, 16 × 32 cores", 1_000, Fleet(16, 32, memory_gib=128, dollars_per_hour=1.3)),
    ("cluster, 100 × 32 cores", 1_000_000, Fleet(100, 32, memory_gib=128, dollars_per_hour=1.3)),
    ("the same, spot machines", 1_000_000, Fleet(100, 32, memory_gib=128, dollars_per_hour=0.5, lost_hours=20)),
    ("cluster, 1000 × 32 cores", 1_000_000, Fleet(1000, 32, memory_gib=128, dollars_per_hour=1.3)),
)


def mean_load() -> CaptureLoad:
    """The mean of the measured captures."""
    columns = list(zip(*MEASURED_SECONDS.values(), strict=True))
    return CaptureLoad(tuple(sum(column) / len(column) for column in columns))


def table(fleets: Sequence[tuple[str, int, Fleet]], shards: int = 1) -> list[str]:
    """Rows of Markdown."""
    load, requests = mean_load(), build_requests(1.0, 0.0)
    rows = [
        "| fleet | captures | hours | captures an hour | cores busy | driver busy | outcome waits, at most | store "
        "reads + writes | dollars |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, captures, fleet in fleets:
        part = replace(fleet, nodes=max(fleet.nodes // shards, 1))
        simulated = min(captures // shards, MAX_SIMULATED)
        result = simulate(simulated, load, part, requests, listed=captures // shards)
        seconds = result.seconds * (captures // shards) / simulated
        hours = seconds / 3600
        rate = captures * (load.bytes_in + load.bytes_out) / seconds
        dollars = hours * fleet.nodes * fleet.dollars_per_hour
        rows.append(
            f"| {name} | {captures:,} | {hours:,.1f} | {captures / hours:,.0f} | {result.busy['CPU']:.0%} | "
            f"{result.driver:.1%} | {result.longest_wait:.1f} s | {rate / 1e6:,.1f} MB/s, "
            f"{captures * load.requests_of_store / seconds:,.0f} requests/s | "
            f"{f'{dollars:,.0f}' if dollars else '–'} |"
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--shards", type=int, default=1, help="Number of parts into which each batch and its fleet are split."
    )
    options = parser.parse_args(arguments)
    print("\n".join(table(FLEETS, options.shards)))


if __name__ == "__main__":
    main()
