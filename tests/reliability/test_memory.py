"""`--max-memory`: estimates, reduced settings, and their messages and records."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hir_core.capture.capture_size import CaptureSize
from hir_core.capture.pixel_cache import DEFAULT_BYTES, PixelCache
from hir_core.config import load_config
from hir_core.errors import ConfigError, StageError
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.run.machine import return_freed_memory
from hir_core.run.run_directory import STAGE_NAMES
from hir_core.stages.memory_plan import parse_size, plan_memory
from tests.reliability.test_long_runs import resident_bytes

PLUGINS = PluginManager.discover()
LARGE = CaptureSize(300, 512, 512)


def test_sizes_are_read_as_people_write_them() -> None:
    assert parse_size("4GB") == parse_size("4 gb") == 4 * 10**9 and parse_size("4GiB") == 4 << 30
    assert parse_size("800MB") == 800 * 10**6 and parse_size("1.5 GB") == 1500 * 10**6 and parse_size("") == 0
    for text in ("a lot", "4 apples", "-1GB", "0", "GB", "1e9", "inf"):
        with pytest.raises(ConfigError, match="max_memory"):
            parse_size(text)


def test_no_limit_changes_nothing() -> None:
    config = load_config(PLUGINS)
    plan = plan_memory(config, PLUGINS, LARGE)
    assert plan.config == config and plan.changes == () and set(plan.stages) >= {"geometry", "reflectance"}


def test_300_views_of_512_are_expected_within_4_gigabytes() -> None:
    plan = plan_memory(replace(load_config(PLUGINS), max_memory="4GiB"), PLUGINS, LARGE)
    assert max(plan.total(stage) for stage in plan.stages) <= 4 << 30
    assert plan.config.geometry.downsample == plan.config.reflectance.downsample == 1, "at full resolution"


@pytest.mark.parametrize("limit", ["3GiB", "2.4GiB", "2GiB", "1.6GiB"])
def test_every_stage_stays_within_the_limit(limit: str) -> None:
    plan = plan_memory(replace(load_config(PLUGINS), max_memory=limit), PLUGINS, LARGE)
    assert plan.changes and plan.cache_bytes < 1 << 30
    assert max(plan.total(stage) for stage in plan.stages) <= parse_size(limit)
    document = plan.document()
    assert document["limit_bytes"] == parse_size(limit) and document["changes"] == list(plan.changes)


def test_a_smaller_limit_asks_for_no_less() -> None:
    plans = [
        plan_memory(replace(load_config(PLUGINS), max_memory=limit), PLUGINS, LARGE)
        for limit in ("3GiB", "2GiB", "1.6GiB")
    ]
    caches = [plan.cache_bytes for plan in plans]
    pixels = [plan.config.reflectance_renderer.get("transport_ggx", {}).get("pixels", 240_000) for plan in plans]
    assert caches == sorted(caches, reverse=True) and pixels == sorted(pixels, reverse=True)


def test_what_cannot_fit_is_refused_before_it_starts() -> None:
    with pytest.raises(StageError, match=r"stage needs about .* GB, more than --max-memory 900MB"):
        plan_memory(replace(load_config(PLUGINS), max_memory="900MB"), PLUGINS, LARGE)


def test_a_run_says_and_writes_what_it_shrank(
    tiny_capture: Path, quick: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A capture of 64×64 pixels fits into anything: decoded pixels are counted as a thousand times as many bytes."""
    for name in ("PIXEL_BYTES", "DECODED_PIXEL_BYTES"):
        monkeypatch.setattr(f"hir_core.stages.memory_plan.{name}", 17_000)
    monkeypatch.setattr("hir_core.stages.memory_plan.MIN_CACHE_BYTES", 1000)
    kept: list[int] = []
    plain = PixelCache.__init__
    monkeypatch.setattr(PixelCache, "__init__", lambda self, most: (kept.append(most), plain(self, most))[1])
    message: list[str] = []
    run = quick(tiny_capture, tmp_path / "run", until="initializer", max_memory="1.7GiB", on_message=message.append)
    memory = run.directory.read_run()["memory"]
    assert memory["limit_bytes"] == int(1.7 * (1 << 30)) and set(memory["estimated_bytes"]) >= {"geometry", "export"}
    assert (
        kept
        and kept[0] < DEFAULT_BYTES
        and any("cache of decoded photographs" in change for change in memory["changes"])
    )
    assert any("to stay within 1.8 GB" in sentence for sentence in message)
    assert any("initializer: about" in sentence and "expected" in sentence for sentence in message)


@pytest.mark.skipif(sys.platform != "linux", reason="glibc")
def test_freed_memory_goes_back_to_the_system() -> None:
    parts = [bytes(2000) for _ in range(100_000)]
    pinned = parts[-1]  # what lies on top keeps all below
    before = resident_bytes()
    parts.clear()
    return_freed_memory()
    assert resident_bytes() < before - (150 << 20) and pinned


FEW_STEPS = (
    "geometry.iterations=30",
    "geometry.photo_consistency_iterations=10",
    "geometry.occlusion_boundary_iterations=10",
    "geometry.outline_iterations=10",
    "reflectance_renderer.transport_ggx.steps=30",
    "checkpoint_seconds=10",
)
"""Memory is that of full length: batches, caches and parameters are the same in every step."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the peak memory is not available")
def test_300_views_of_512_take_at_most_4_gigabytes(shared: Path, tmp_path: Path) -> None:
    """docs/reliability.md has the figures."""
    from hir_plugins.commands.bench.inputs.bench_captures import make_resized_capture

    capture = make_resized_capture(shared / "captures" / "spot", tmp_path / "capture", 300, 512)
    arguments = [
        sys.executable,
        "-m",
        "hir_core.cli",
        "reconstruct",
        str(capture),
        "-o",
        str(tmp_path / "run"),
        "-q",
        "--max-memory",
        "4GiB",
        "--until",
        "bake",
        "--device",
        "cpu",
    ]
    settings = [word for assignment in FEW_STEPS for word in ("--set", assignment)]
    subprocess.run([*arguments, *settings], check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    stages = json.loads((tmp_path / "run" / "timings.json").read_text())["stages"]
    estimated = json.loads((tmp_path / "run" / "run.json").read_text())["memory"]["estimated_bytes"]
    measured = {name: stage["peak_memory_bytes"] for name, stage in stages.items()}
    print({name: f"{size / (1 << 30):.2f} GiB of {estimated[name] / (1 << 30):.2f}" for name, size in measured.items()})
    assert max(measured.values()) <= 4 << 30
    assert set(measured) >= {"initializer", "geometry", "atlas", "reflectance", "bake"}
    # a peak is that of all stages so far
    output = [name for name in STAGE_NAMES if name in measured]
    assert all(measured[name] <= max(estimated[n] for n in output[: i + 1]) for i, name in enumerate(output))
