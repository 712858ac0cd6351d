"""What tasks ask for, and how much a cluster has room for."""

from __future__ import annotations

import pytest

from hir_core.errors import ConfigError
from hir_plugins.commands.batch.stage_groups import (
    GROUPS,
    Request,
    Requests,
    build_requests,
    slots,
    unplaceable,
    window,
)

GIB = 2.0**30
LAPTOP = {"CPU": 8.0, "memory": 12 * GIB}
GPU_NODE = {"CPU": 32.0, "GPU": 4.0, "memory": 200 * GIB}


def test_groups_with_a_gpu_wait_for_no_core() -> None:
    requests = build_requests(cpus=2.0, gpus=0.5)
    assert requests.geometry == Request(0.0, 0.5, Requests().geometry.memory_gib) and requests.geometry.threads == 1
    assert requests.initialization.cpus == requests.export.cpus == 2.0 and requests.export.gpus == 0.0
    without = build_requests(cpus=3.0, gpus=0.0)
    assert all(without.of(group).cpus == 3.0 and without.of(group).threads == 3 for group in GROUPS)


def test_single_requests_win() -> None:
    requests = build_requests(1.0, 0.25, ["reflectance.memory_gib=12", "reflectance.cpus=4", "export.memory_gib=0.5"])
    assert requests.reflectance == Request(4.0, 0.25, 12.0) and requests.export.memory_gib == 0.5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["atlas.cpus=1"], "no group 'atlas'; the groups are: initialization, geometry, reflectance, export"),
        (["export.cpu=1"], "unknown option 'cpu'; did you mean 'cpus'"),
        (["export=2"], r"write export\.cpus=2"),
        (["export.cpus=0"], "asks for 0 CPUs and 0 GPUs"),
        (["export.gpus=1.5"], "a share is below 1, more are whole"),
        (["export.cpus=-1", "export.gpus=2"], "asks for -1 CPUs"),
    ],
)
def test_wrong_requests_are_one_sentence(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build_requests(1.0, 0.0, words)


def test_slots_are_counted_node_by_node() -> None:
    half = {"CPU": 1.5, "memory": 100 * GIB}
    assert slots([half, half], Request(1.0, 0.0, 0.0)) == 2, "two halves of a core are on two nodes"
    assert slots([LAPTOP], Request(1.0, 0.0, 4.0)) == 3, "memory ends before cores do"
    assert slots([GPU_NODE, LAPTOP], Request(0.0, 0.25, 4.0)) == 16
    assert slots([LAPTOP], Request(0.0, 1.0, 0.0)) == 0


def test_window_has_room_for_both_kinds_of_tasks_and_a_few_that_wait() -> None:
    assert window([LAPTOP], build_requests(1.0, 0.0)) == 12 - 4 + 1, "export asks for 1 GiB: eight cores end first"
    assert window([GPU_NODE], build_requests(1.0, 1.0)) == (4 + 32) + 4
    assert window([], build_requests(1.0, 0.0)) == 1, "a cluster that grows by what waits needs something to wait"


def test_task_that_fits_nowhere_is_named() -> None:
    assert unplaceable([LAPTOP], build_requests(1.0, 0.0)) == ""
    assert "what geometry asks for: 0 CPUs, 1 GPUs" in unplaceable([LAPTOP], build_requests(1.0, 1.0))
    small = {"CPU": 2.0, "memory": 3 * GIB}
    assert "--request reflectance.memory_gib" in unplaceable([small, small], build_requests(1.0, 0.0))
