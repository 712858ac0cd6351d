"""The four tasks of a capture, what each asks of a node, and how many captures a cluster has room for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from hir_core.config import assign
from hir_core.errors import ConfigError
from hir_core.plugins.options import build_options
from hir_core.run.run_directory import STAGES


@dataclass(frozen=True)
class Group:
    """Stages that one task runs, one after the other."""

    name: str
    stages: tuple[str, ...]

    @property
    def until(self) -> str:
        """The stage after which the task ends."""
        return self.stages[-1]


GROUPS: Final = (
    Group("initialization", ("initializer",)),
    Group("geometry", ("geometry",)),
    Group("reflectance", ("atlas", "reflectance")),
    Group("export", ("bake", "export")),
)
assert tuple(stage for group in GROUPS for stage in group.stages) == STAGES

ON_THE_GPU: Final = ("geometry", "reflectance")
"""Groups that `--gpus` is for: the others compute on the processor."""


@dataclass(frozen=True)
class Request:
    """What Ray sets aside for one task."""

    cpus: float = 1.0
    """Cores; the task runs with as many threads, at least one."""
    gpus: float = 0.0
    """GPUs or a share of one; a task without one runs on the processor."""
    memory_gib: float = 2.0

    @property
    def threads(self) -> int:
        return max(1, int(self.cpus))

    def resources(self) -> dict[str, float]:
        """Ray's names and units."""
        return {"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * 2**30}


@dataclass(frozen=True)
class Requests:
    """One request for each group; memory as measured on captures of 80 photographs of 512² (docs/scaling.md)."""

    initialization: Request = Request(memory_gib=1.5)
    geometry: Request = Request(memory_gib=2.0)
    reflectance: Request = Request(memory_gib=4.0)
    export: Request = Request(memory_gib=1.0)

    def of(self, group: Group) -> Request:
        found: Request = getattr(self, group.name)
        return found


def build_requests(cpus: float, gpus: float, assignments: Sequence[str] = ()) -> Requests:
    """The defaults with `cpus` for all and `gpus` where they help, then single ones such as `reflectance.cpus=4`.

    A task with a GPU asks for no core: it would wait for one behind the tasks of other captures that have nothing else.
    """
    table: dict[str, Any] = {}
    for assignment in assignments:
        assign(table, assignment)
    usual = Requests()
    merged: dict[str, Any] = {}
    for group in GROUPS:
        with_gpu = gpus > 0 and group.name in ON_THE_GPU
        request = replace(usual.of(group), cpus=0.0 if with_gpu else cpus, gpus=gpus if with_gpu else 0.0)
        single = table.pop(group.name, {})
        if not isinstance(single, Mapping):
            raise ConfigError(f"--request {group.name}: write {group.name}.cpus=2, .gpus=0.5 or .memory_gib=6")
        merged[group.name] = build_options(Request, {**vars(request), **single}, f"--request {group.name}")
    if table:
        known = ", ".join(group.name for group in GROUPS)
        raise ConfigError(f"--request: there is no group {sorted(table)[0]!r}; the groups are: {known}")
    requests = Requests(**merged)
    for group in GROUPS:
        request = requests.of(group)
        if min(request.cpus, request.gpus, request.memory_gib) < 0 or request.cpus + request.gpus <= 0:
            raise ConfigError(f"{group.name} asks for {request.cpus:g} CPUs and {request.gpus:g} GPUs; ask for some")
        if request.gpus > 1 and request.gpus != int(request.gpus):
            raise ConfigError(f"{group.name} asks for {request.gpus:g} GPUs; a share is below 1, more are whole")
    return requests


def slots(nodes: Sequence[Mapping[str, float]], request: Request) -> int:
    """Tasks of a group that the nodes have room for at once, each node given as what it has in all."""
    wanted = {name: amount for name, amount in request.resources().items() if amount > 0}
    return sum(min(int(node.get(name, 0.0) / amount + 1e-9) for name, amount in wanted.items()) for node in nodes)


def window(nodes: Sequence[Mapping[str, float]], requests: Requests) -> int:
    """Captures to work on at once: room for tasks with a GPU and for those without, and a few that wait for a place.

    Ray takes tasks in the order they come: were all captures handed to it at once, every first task would run before
    any second one, and the first result would come last.
    """
    with_gpu = [slots(nodes, requests.of(group)) for group in GROUPS if requests.of(group).gpus > 0]
    without = [slots(nodes, requests.of(group)) for group in GROUPS if requests.of(group).gpus == 0]
    room = max(with_gpu, default=0) + max(without, default=0)
    return room + max(1, room // 8)


def unplaceable(nodes: Sequence[Mapping[str, float]], requests: Requests) -> str:
    """One sentence where a group fits on no node, empty where all fit."""
    for group in GROUPS:
        request = requests.of(group)
        if slots(nodes, request) == 0:
            return (
                f"no node has what {group.name} asks for: {request.cpus:g} CPUs, {request.gpus:g} GPUs and "
                f"{request.memory_gib:g} GiB; ask for less with --request {group.name}.memory_gib=… "
                "(or .cpus, .gpus), or add a node"
            )
    return ""
