"""Long runs: memory does not grow, progress is reported regularly, logs rotate."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.optimization.optimization_loop import optimize
from hir_core.optimization.schedules import Schedule
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run import progress_listener
from hir_core.run.machine import return_freed_memory
from hir_core.run.progress_listener import ProgressListener
from hir_core.run.run_log import BACKUP_FILES, MAX_LOG_BYTES, write_log
from hir_core.terminal import progress_bar
from hir_core.terminal.progress_bar import ProgressBar


def resident_bytes() -> int:
    """Of this process, now."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) << 10
    pytest.skip("the system does not say how much memory a process has")


def test_a_silent_stage_is_said_to_be_alive(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stage that reports nothing at all: a line within 5 s; here all times are a fifth of that."""
    assert progress_bar.LINE_SECONDS + progress_listener.HEARTBEAT_INTERVAL_S <= 5.0
    monkeypatch.setattr(progress_bar, "LINE_SECONDS", progress_bar.LINE_SECONDS / 5)
    monkeypatch.setattr(progress_listener, "HEARTBEAT_INTERVAL_S", progress_listener.HEARTBEAT_INTERVAL_S / 5)
    times: list[float] = []
    with ProgressBar() as bar:

        def on_progress(progress: Progress) -> None:
            before = len(capsys.readouterr().err)
            bar.update(progress)
            if len(capsys.readouterr().err) and not before:
                times.append(time.monotonic())

        listener = ProgressListener("initializer", PluginManager(), on_progress)
        started = time.monotonic()
        with listener.heartbeat():
            time.sleep(1.12)
        ended = time.monotonic()
    # a second more than is promised: other tests may have the processors
    assert times and max(np.diff([started, *times, ended])) <= 2.0


def test_a_stage_that_reports_is_not_talked_over() -> None:
    output: list[Progress] = []
    listener = ProgressListener("geometry", PluginManager(), output.append)
    with listener.heartbeat():
        for step in range(1, 13):
            time.sleep(0.1)
            listener.report(Progress("geometry", step, 100, 0.0, {"loss": np.array([1.0])}))
    assert all("loss" in p.scalars for p in output), "no repetition came between"
    assert sum(len(p.scalars["loss"]) for p in output) <= 12


def test_logs_rotate(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    for _ in range(8_500):
        write_log(path, "x" * 500 + "\nsecond line")
    files = sorted(tmp_path.iterdir())
    assert [f.name for f in files] == ["log.txt", *(f"log.txt.{i + 1}" for i in range(BACKUP_FILES))]
    assert all(f.stat().st_size <= MAX_LOG_BYTES for f in files)
    assert path.read_text().splitlines()[-1].endswith("x second line"), "one line a sentence"
    write_log(tmp_path / "missing" / "log.txt", "a folder that is gone loses the line, not the run")


@pytest.mark.slow
def test_5000_steps_of_the_loop_keep_their_memory() -> None:
    x = torch.zeros(1000, 3, requires_grad=True)
    sizes: list[int] = []

    def after(step: int) -> bool:
        if step % 1000 == 999:
            return_freed_memory()  # what other tests left free is no growth
            sizes.append(resident_bytes())
        return False

    optimize(
        lambda _: {"far": (x - 1).square().sum(), "flat": x.abs().sum()},
        torch.optim.Adam([x], 0.01),
        Schedule(5000),
        stage="test",
        after_step=after,
    )
    # curves grow by 3 scalars of 4 bytes a step
    assert sizes[-1] - sizes[0] < 4 << 20, sizes


PATH_TRACER = """
import gc, sys
import torch
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.plugins.manager import PluginManager
from hir_core.testing.scenes import bumpy_scene, looking_at
from hir_core.capture import Capture, View
from pathlib import Path
from tests.reliability.test_long_runs import resident_bytes

import drjit as dr

torch.set_num_threads(1)
scene = bumpy_scene()
camera = looking_at((0.0, 0.5, 3.0), 16)
capture = Capture(Path("."), (View("a", camera, lambda: None),))
prepared = PluginManager.discover().create("reflectance_renderer", sys.argv[1], {"samples": 4}).prepare(scene, capture)
generator = torch.Generator().manual_seed(0)
steps, sizes = int(sys.argv[2]), []
light = scene.environment.radiance.clone().requires_grad_(True)
for step in range(steps):
    # batches of many sizes, as the pixels of views have: each could leave a kernel behind
    count = 60 + int(torch.randint(0, 8, (), generator=generator))
    pixels = torch.randint(0, 16, (count, 3), generator=generator) * torch.tensor([0, 1, 1])
    environment = type(scene.environment)(light, None, "world")
    prepared.radiance(scene.material, environment, pixels).sum().backward()
    light.grad = None
    if step % (steps // 5) == steps // 5 - 1:
        gc.collect()
        sizes.append(resident_bytes())
print(*sizes)
"""


@pytest.mark.slow
@pytest.mark.parametrize("renderer", ["transport_ggx", "mitsuba_ggx"])
def test_5000_steps_of_a_renderer_leave_nothing_in_its_compilers_caches(renderer: str) -> None:
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", PATH_TRACER, renderer, "5000"],
        capture_output=True,
        text=True,
        cwd=root,
        check=True,
        env={**__import__("os").environ, "PYTHONPATH": str(root)},
    )
    sizes = [int(word) for word in done.stdout.split()]
    assert len(sizes) == 5
    assert sizes[-1] - sizes[0] < 32 << 20, [size >> 20 for size in sizes]
