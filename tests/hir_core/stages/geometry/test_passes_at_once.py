"""Passes of the photo-consistency refinement side by side: their order, progress and failures."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.photo_consistency.detail_images import of_each_view
from hir_core.stages.geometry.photo_consistency.passes_at_once import one_at_a_time, passes_at_once, run_passes
from tests.fixtures.meshes import around, capture_of, icosphere, mesh_of
from tests.fixtures.torch_threads import torch_threads


@pytest.fixture(autouse=True)
def two_threads():  # type: ignore[no-untyped-def]
    with torch_threads(2):
        yield


def test_observers_receive_the_passes_one_after_the_other(tmp_path: Path) -> None:
    shown: list[int] = []
    warned: list[str] = []
    context = StageContext(
        PluginManager(), tmp_path, report=lambda progress: shown.append(progress.step), warn=warned.append
    )
    both = threading.Barrier(2, timeout=60)

    def fit(own: StageContext, first: int) -> int:
        for step in range(first, first + 3):
            both.wait()  # raises where the other one does not run
            own.report(Progress("geometry", step, 6, 0.0))
        own.warn(f"after {first}")
        return first

    passes = [lambda own: fit(own, 0), lambda own: fit(own, 3)]
    assert run_passes(passes, context, 2) == [0, 3]
    assert shown == list(range(6)) and sorted(warned) == ["after 0", "after 3"]
    assert torch.get_num_threads() == 2


def test_one_pass_after_the_other_has_the_context_itself(tmp_path: Path) -> None:
    context = StageContext(PluginManager(), tmp_path)
    assert run_passes([lambda own: own, lambda own: own], context, 1) == [context, context]
    assert run_passes([lambda own: own], context, 2) == [context]


def test_a_pass_that_fails_stops_the_other(tmp_path: Path) -> None:
    stopped = threading.Event()

    def endless(own: StageContext) -> None:
        try:
            until = time.monotonic() + 60
            while time.monotonic() < until:
                own.report(Progress("geometry", 1, 2, 0.0))
                time.sleep(0.001)
        finally:
            stopped.set()

    def fails(own: StageContext) -> None:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run_passes([endless, fails], StageContext(PluginManager(), tmp_path), 2)
    assert stopped.is_set()


def test_a_renderer_is_called_by_one_thread_at_a_time() -> None:
    inside, most = 0, 0

    def iou(mesh: Mesh, views: list[int]) -> Tensor:
        nonlocal inside, most
        inside += 1
        most = max(most, inside)
        time.sleep(0.01)
        inside -= 1
        return torch.ones(len(views))

    shared, mesh = one_at_a_time(iou), mesh_of(*icosphere(0))
    found = of_each_view(lambda view: shared(mesh, [view]), 6)
    assert most == 1 and len(found) == 6


@pytest.mark.parametrize("name", ["contour", "soft_silhouette"])
def test_gradients_of_two_threads_are_those_of_one(name: str) -> None:
    """`GeometryRenderer.overlap` says that they may be computed at the same time."""
    positions, faces = icosphere(2)
    cameras = around(3, 32)
    renderer: GeometryRenderer = PluginManager.discover().create("geometry_renderer", name)
    targets = renderer.prepare(capture_of(positions, faces, cameras).views)
    lock = threading.Lock()

    def gradient(scale: float) -> Tensor:
        moved = (scale * torch.from_numpy(positions).float()).requires_grad_()
        mesh = mesh_of(positions, faces).with_positions(moved)
        with lock:
            area, overlap = renderer.overlap(mesh, targets)
        (area + 2 * overlap).sum().backward()
        assert moved.grad is not None
        return moved.grad

    scales = [0.9, 1.0, 1.1, 0.95] * 4
    alone = [gradient(scale) for scale in scales]
    beside = of_each_view(lambda view: gradient(scales[view]), len(scales))
    assert all(float(one.abs().max()) > 0 for one in alone)
    assert all(torch.allclose(*pair, rtol=1e-6, atol=1e-6) for pair in zip(alone, beside, strict=True))


def test_a_gpu_runs_one_pass_at_a_time() -> None:
    assert passes_at_once(torch.device("cuda")) == 1 and passes_at_once(torch.device("cpu")) == 2
    with torch_threads(1):
        assert passes_at_once(torch.device("cpu")) == 1
