"""How long a large batch takes and what it costs: a simulation of captures, nodes, driver and store.

    python -m benchmarks.batch.model                 # 10³ and 10⁶ captures on fleets, from measured stage seconds
    python -m benchmarks.batch.measured              # local batches, against what the model says of them

The simulation knows what `hir batch` knows: groups, requests, the window of captures in progress, one driver that
handles one outcome at a time and rewrites its manifest. It plays all tasks through, with spread and with workers that
die. It does not know which node a task is on: a fleet is one pool of cores, GPUs and memory.
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
class Load:
    """One capture: seconds of each group on one core, and what travels."""

    seconds: tuple[float, ...]
    spread: float = 0.25
    """Standard deviation of the logarithm of a capture's seconds, the same factor for all its groups."""
    bytes_in: float = 17e6
    bytes_out: float = 45e6
    """The result and, on the way, the stages that are kept for other nodes."""
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
    """Mean hours until a worker's node is lost: spot machines are taken away."""

    @property
    def resources(self) -> list[Mapping[str, float]]:
        return [{"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * GIB}] * self.nodes


@dataclass(frozen=True)
class Overhead:
    """Seconds that no stage computes; the figures are those that benchmarks.batch.measured gives (docs/scaling.md)."""

    worker_start: float = 7.4
    """Until a new worker's process has loaded what it needs."""
    task: float = 0.63
    """From handing a task out to its outcome, beside what the worker does: Ray, staging, keeping."""
    handling: float = 0.022
    """Of the driver, for each task."""
    entry: float = 2.4e-5
    """Of the driver, for each capture, whenever it writes the manifest."""
    tasks_of_a_worker: int = 64


@dataclass
class Played:
    """What came out of a simulation."""

    seconds: float = 0.0
    busy: dict[str, float] = field(default_factory=dict)
    """Share of CPU and GPU time that tasks held."""
    driver: float = 0.0
    """Share of the time that the driver worked."""
    lost: int = 0
    """Tasks that died and were begun again."""
    longest_wait: float = 0.0
    """Seconds that an outcome waited for the driver, at most."""


def play(
    captures: int,
    load: Load,
    fleet: Fleet,
    requests: ResourceRequests,
    overhead: Overhead = Overhead(),
    seed: int = 0,
    listed: int = 0,
) -> Played:
    """Plays a batch through; `listed` captures are in the manifest, by default those that are played."""
    chance = random.Random(seed)
    asked = [requests.of(group) for group in STAGE_GROUPS]
    needs = [{name: amount for name, amount in request.resources().items() if amount > 0} for request in asked]
    free = {name: sum(node[name] for node in fleet.resources) for name in ("CPU", "GPU", "memory")}
    total = dict(free)
    room = max_captures_in_progress(fleet.resources, requests)
    unopened = room  # workers that have not begun yet
    patience = RetryPolicy(3, initial_wait_s=2.0, factor=4.0)
    played = Played(busy={"CPU": 0.0, "GPU": 0.0})
    waiting: list[deque[float]] = [deque() for _ in STAGE_GROUPS]
    """Speeds of the captures that wait for their next group."""
    events: list[tuple[float, int, str, int, float]] = []  # time, order, what, group, speed
    driver_free = manifest_due = now = 0.0
    begun = done = order = running = 0

    def later(time: float, what: str, group: int, factor: float) -> None:
        nonlocal order
        order += 1
        heapq.heappush(events, (time, order, what, group, factor))

    def start(time: float, group: int, factor: float) -> None:
        nonlocal running, unopened
        for name, amount in needs[group].items():
            free[name] -= amount
        seconds = load.seconds[group] * factor / asked[group].threads + overhead.task
        if asked[group].gpus > 0:
            seconds += overhead.worker_start  # CUDA: a process for each task
        elif unopened > 0 or chance.random() < 1 / overhead.tasks_of_a_worker:
            unopened -= 1
            seconds += overhead.worker_start
        lost = chance.random() < 1 - math.exp(-seconds / 3600 / fleet.lost_hours)
        if lost:
            seconds *= chance.random()
        for name in ("CPU", "GPU"):
            played.busy[name] += needs[group].get(name, 0.0) * seconds
        running += 1
        later(time + seconds, "lost" if lost else "done", group, factor)

    def hand_out(time: float) -> None:
        """Whatever fits, the furthest first; as in Ray, a task that waits for a GPU is in no other's way."""
        nonlocal begun
        for group in reversed(range(len(STAGE_GROUPS))):
            while waiting[group] and all(free[k] + 1e-9 >= v for k, v in needs[group].items()):
                start(time, group, waiting[group].popleft())
        while begun < captures and running + sum(map(len, waiting)) < room:
            factor = math.exp(chance.gauss(0.0, load.spread))
            begun += 1
            waiting[0].append(factor)
            if all(free[k] + 1e-9 >= v for k, v in needs[0].items()):
                start(time, 0, waiting[0].popleft())

    hand_out(0.0)
    while done < captures:
        now, _, what, group, factor = heapq.heappop(events)
        if what == "again":
            waiting[group].append(factor)
            hand_out(now)
            continue
        running -= 1
        for name, amount in needs[group].items():
            free[name] += amount
        handled = max(now, driver_free)
        if handled >= manifest_due:
            written = (listed or captures) * overhead.entry
            played.driver += written
            handled += written
            manifest_due = handled + max(1.0, written / 0.05)
        handled += overhead.handling
        played.driver += overhead.handling
        played.longest_wait = max(played.longest_wait, handled - now)
        driver_free = handled
        if what == "lost":
            played.lost += 1
            later(handled + policy.wait_s(1), "again", group, factor)
        elif group + 1 < len(STAGE_GROUPS):
            waiting[group + 1].append(factor)
        else:
            done += 1
        hand_out(handled)
    played.seconds = max(now, driver_free)
    played.driver /= played.seconds
    for name in played.busy:
        played.busy[name] = played.busy[name] / (total[name] * played.seconds) if total[name] else 0.0
    return played


MOST_PLAYED = 100_000
"""Of a larger batch so many are played, with the manifest of all, and their time is multiplied."""

ONE_CORE = {
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


def mean_load() -> Load:
    """The mean of the three captures that were measured."""
    columns = list(zip(*ONE_CORE.values(), strict=True))
    return Load(tuple(sum(column) / len(column) for column in columns))


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
        played = min(captures // shards, MOST_PLAYED)
        found = play(played, load, part, requests, listed=captures // shards)
        seconds = found.seconds * (captures // shards) / played
        hours = seconds / 3600
        rate = captures * (load.bytes_in + load.bytes_out) / seconds
        dollars = hours * fleet.nodes * fleet.dollars_per_hour
        rows.append(
            f"| {name} | {captures:,} | {hours:,.1f} | {captures / hours:,.0f} | {found.busy['CPU']:.0%} | "
            f"{found.driver:.1%} | {found.longest_wait:.1f} s | {rate / 1e6:,.1f} MB/s, "
            f"{captures * load.requests_of_store / seconds:,.0f} requests/s | "
            f"{f'{dollars:,.0f}' if dollars else '–'} |"
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shards", type=int, default=1, help="Split each batch and its fleet into so many.")
    options = parser.parse_args(arguments)
    print("\n".join(table(FLEETS, options.shards)))


if __name__ == "__main__":
    main()
