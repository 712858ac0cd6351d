"""The resources that tasks request, and the capacity of clusters."""

from __future__ import annotations

import pytest

from hir_core.errors import ConfigError
from hir_plugins.commands.batch.cluster_capacity import max_captures_in_progress, task_slots, unsatisfiable_request
from hir_plugins.commands.batch.resource_requests import ResourceRequest, ResourceRequests, build_requests
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

GIB = 2.0**30
LAPTOP = {"CPU": 8.0, "memory": 12 * GIB}
GPU_NODE = {"CPU": 32.0, "GPU": 4.0, "memory": 200 * GIB}


def test_groups_with_a_gpu_request_no_core() -> None:
    requests = build_requests(cpus=2.0, gpus=0.5)
    assert (
        requests.geometry == ResourceRequest(0.0, 0.5, ResourceRequests().geometry.memory_gib)
        and requests.geometry.threads == 1
    )
    assert requests.initialization.cpus == requests.export.cpus == 2.0 and requests.export.gpus == 0.0
    without = build_requests(cpus=3.0, gpus=0.0)
    assert all(without.of(group).cpus == 3.0 and without.of(group).threads == 3 for group in STAGE_GROUPS)


def test_assignments_override_the_defaults() -> None:
    requests = build_requests(1.0, 0.25, ["reflectance.memory_gib=12", "reflectance.cpus=4", "export.memory_gib=0.5"])
    assert requests.reflectance == ResourceRequest(4.0, 0.25, 12.0) and requests.export.memory_gib == 0.5


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        (["atlas.cpus=1"], "no group 'atlas'; the groups are: initialization, geometry, reflectance, export"),
        (["export.cpu=1"], "unknown option 'cpu'; did you mean 'cpus'"),
        (["export=2"], r"write export\.cpus=2"),
        (["export.cpus=0"], "export: 0 CPUs and 0 GPUs: a task needs a CPU or a GPU"),
        (["export.gpus=1.5"], "above 1, the number of GPUs must be whole"),
        (["export.cpus=-1", "export.gpus=2"], "-1 CPUs and 2 GPUs: amounts must not be negative"),
    ],
)
def test_invalid_requests_are_one_sentence(assignments: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build_requests(1.0, 0.0, assignments)


def test_slots_are_counted_node_by_node() -> None:
    half = {"CPU": 1.5, "memory": 100 * GIB}
    assert task_slots([half, half], ResourceRequest(1.0, 0.0, 0.0)) == 2, "the free half cores are on two nodes"
    assert task_slots([LAPTOP], ResourceRequest(1.0, 0.0, 4.0)) == 3, "memory is exhausted before cores"
    assert task_slots([GPU_NODE, LAPTOP], ResourceRequest(0.0, 0.25, 4.0)) == 16
    assert task_slots([LAPTOP], ResourceRequest(0.0, 1.0, 0.0)) == 0


def test_captures_in_progress_fill_cpu_and_gpu_slots_and_the_queue() -> None:
    assert max_captures_in_progress([LAPTOP], build_requests(1.0, 0.0)) == 12 - 4 + 1, (
        "export requests 1 GiB: the eight cores are exhausted first"
    )
    assert max_captures_in_progress([GPU_NODE], build_requests(1.0, 1.0)) == (4 + 32) + 4
    assert max_captures_in_progress([], build_requests(1.0, 0.0)) == 1, "an autoscaler adds nodes for queued tasks"


def test_task_that_exceeds_every_node_is_named() -> None:
    assert unsatisfiable_request([LAPTOP], build_requests(1.0, 0.0)) == ""
    assert "that geometry requests: 0 CPUs, 1 GPUs" in unsatisfiable_request([LAPTOP], build_requests(1.0, 1.0))
    small = {"CPU": 2.0, "memory": 3 * GIB}
    assert "--request reflectance.memory_gib" in unsatisfiable_request([small, small], build_requests(1.0, 0.0))
