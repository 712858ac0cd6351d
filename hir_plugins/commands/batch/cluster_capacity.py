"""How many tasks and captures a cluster has capacity for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hir_plugins.commands.batch.resource_requests import ResourceRequest, ResourceRequests
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

Node = Mapping[str, float]
"""The total resources of a node under Ray's names; memory in bytes."""


def task_slots(nodes: Sequence[Node], request: ResourceRequest) -> int:
    """The number of tasks with this request that idle nodes can run at the same time."""
    amounts = {name: amount for name, amount in request.resources().items() if amount > 0}
    return sum(min(int(node.get(name, 0.0) / amount + 1e-9) for name, amount in amounts.items()) for node in nodes)


def max_captures_in_progress(nodes: Sequence[Node], requests: ResourceRequests) -> int:
    """The number of captures to process at the same time: enough for all GPU slots and all CPU slots, plus an eighth
    that waits in Ray's queue.

    Ray runs tasks in the order in which they are submitted. If all captures were submitted at once, every first task
    would run before any second task, and the first result would come last.
    """
    with_gpu = [task_slots(nodes, requests.of(group)) for group in STAGE_GROUPS if requests.of(group).gpus > 0]
    without = [task_slots(nodes, requests.of(group)) for group in STAGE_GROUPS if requests.of(group).gpus == 0]
    slots = max(with_gpu, default=0) + max(without, default=0)
    return slots + max(1, slots // 8)


def unsatisfiable_request(nodes: Sequence[Node], requests: ResourceRequests) -> str:
    """One sentence about a group whose request exceeds every node, or an empty string."""
    for group in STAGE_GROUPS:
        request = requests.of(group)
        if task_slots(nodes, request) == 0:
            return (
                f"no node has the resources that {group.name} requests: {request.cpus:g} CPUs, {request.gpus:g} GPUs "
                f"and {request.memory_gib:g} GiB; request less with --request {group.name}.memory_gib=… "
                "(or .cpus, .gpus), or add a node"
            )
    return ""
