"""The CPUs, GPUs and memory that each task requests from Ray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from hir_core.config import assign
from hir_core.errors import ConfigError
from hir_core.plugins.options import build_options
from hir_plugins.commands.batch.stage_groups import GPU_GROUPS, STAGE_GROUPS, StageGroup

BYTES_PER_GIB: Final = 2**30


@dataclass(frozen=True)
class ResourceRequest:
    """What Ray reserves for one task."""

    cpus: float = 1.0
    """CPU cores; the task uses as many threads, at least one."""
    gpus: float = 0.0
    """GPUs, or a fraction of one; a task without a GPU computes on the CPU."""
    memory_gib: float = 2.0

    @property
    def threads(self) -> int:
        return max(1, int(self.cpus))

    def resources(self) -> dict[str, float]:
        """The request under Ray's names and in Ray's units."""
        return {"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * BYTES_PER_GIB}


@dataclass(frozen=True)
class ResourceRequests:
    """One request for each stage group; the memory is that of captures of 80 images of 512². Larger ones need more
    (docs/scaling.md)."""

    initialization: ResourceRequest = ResourceRequest(memory_gib=1.5)
    geometry: ResourceRequest = ResourceRequest(memory_gib=2.0)
    reflectance: ResourceRequest = ResourceRequest(memory_gib=4.0)
    export: ResourceRequest = ResourceRequest(memory_gib=1.0)

    def of(self, group: StageGroup) -> ResourceRequest:
        request: ResourceRequest = getattr(self, group.name)
        return request


def build_requests(cpus: float, gpus: float, assignments: Sequence[str] = ()) -> ResourceRequests:
    """The defaults with `cpus` for all groups and `gpus` for those that use one, then assignments such as
    `reflectance.cpus=4`.

    A task with a GPU requests no CPU core: otherwise it would wait for one behind CPU tasks of other captures.
    Raises `ConfigError` for unknown groups, unknown keys and amounts that Ray refuses.
    """
    table: dict[str, Any] = {}
    for assignment in assignments:
        if "=" not in assignment:
            raise ConfigError(f"--request {assignment!r}: write it as KEY=VALUE, such as reflectance.memory_gib=6")
        assign(table, assignment)
    defaults = ResourceRequests()
    requests: dict[str, ResourceRequest] = {}
    for group in STAGE_GROUPS:
        with_gpu = gpus > 0 and group.name in GPU_GROUPS
        request = replace(defaults.of(group), cpus=0.0 if with_gpu else cpus, gpus=gpus if with_gpu else 0.0)
        assigned = table.pop(group.name, {})
        if not isinstance(assigned, Mapping):
            raise ConfigError(f"--request {group.name}: write {group.name}.cpus=2, .gpus=0.5 or .memory_gib=6")
        values = {**vars(request), **assigned}
        requests[group.name] = build_options(ResourceRequest, values, f"--request {group.name}")
    if table:
        known = ", ".join(group.name for group in STAGE_GROUPS)
        raise ConfigError(f"--request: there is no group {sorted(table)[0]!r}; the groups are: {known}")
    for name, request in requests.items():
        _check(name, request)
    return ResourceRequests(**requests)


def _check(group: str, request: ResourceRequest) -> None:
    amounts = f"--request {group}: {request.cpus:g} CPUs and {request.gpus:g} GPUs"
    if min(request.cpus, request.gpus, request.memory_gib) < 0:
        raise ConfigError(f"{amounts}: amounts must not be negative")
    if request.cpus + request.gpus <= 0:
        raise ConfigError(f"{amounts}: a task needs a CPU or a GPU")
    if request.gpus > 1 and request.gpus != int(request.gpus):
        raise ConfigError(f"{amounts}: above 1, the number of GPUs must be whole")
