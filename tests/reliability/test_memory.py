"""`--max-memory`: estimates, what shrinks, and that it is said and written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hir_core.config import RunConfig, load_config
from hir_core.errors import ConfigError, StageError
from hir_core.manager import PluginManager
from hir_core.memory import CaptureSize, parse_size, plan_memory
from hir_core.pipeline import Run
from hir_core.pixel_cache import PixelCache

PLUGINS = PluginManager.discover()
LARGE = CaptureSize(300, 512, 512)


def test_sizes_are_read_as_people_write_them() -> None:
    assert parse_size("4GB") == parse_size("4 GiB") == parse_size("4g") == 4 << 30
    assert parse_size("800MB") == 800 << 20 and parse_size("1.5 g") == 3 << 29 and parse_size("") == 0
    for text in ("a lot", "4 apples", "-1GB", "0", "GB", "1e9", "inf"):
        with pytest.raises(ConfigError, match="max_memory"):
            parse_size(text)


def test_no_limit_changes_nothing() -> None:
    config = load_config(PLUGINS)
    plan = plan_memory(config, PLUGINS, LARGE)
    assert plan.config == config and plan.changes == () and set(plan.stages) >= {"geometry", "reflectance"}


def test_300_views_of_512_are_expected_within_4_gigabytes() -> None:
    plan = plan_memory(replace(load_config(PLUGINS), max_memory="4GB"), PLUGINS, LARGE)
    assert max(plan.total(stage) for stage in plan.stages) <= 4 << 30
    assert plan.config.geometry.downsample == plan.config.reflectance.downsample == 1, "at full resolution"


@pytest.mark.parametrize("limit", ["3GB", "2.4GB", "2GB", "1.6GB"])
def test_every_stage_stays_within_the_limit(limit: str) -> None:
    plan = plan_memory(replace(load_config(PLUGINS), max_memory=limit), PLUGINS, LARGE)
    assert plan.changes and plan.cache_bytes < 1 << 30
    assert max(plan.total(stage) for stage in plan.stages) <= parse_size(limit)
    document = plan.document()
    assert document["limit_bytes"] == parse_size(limit) and document["changes"] == list(plan.changes)


def test_a_smaller_limit_asks_for_no_less() -> None:
    plans = [
        plan_memory(replace(load_config(PLUGINS), max_memory=limit), PLUGINS, LARGE)
        for limit in ("3GB", "2GB", "1.6GB")
    ]
    caches = [plan.cache_bytes for plan in plans]
    pixels = [plan.config.reflectance_renderer.get("transport_ggx", {}).get("pixels", 240_000) for plan in plans]
    assert caches == sorted(caches, reverse=True) and pixels == sorted(pixels, reverse=True)


def test_what_cannot_fit_is_refused_before_it_starts() -> None:
    with pytest.raises(StageError, match=r"stage needs about .* GB, more than --max-memory 900MB"):
        plan_memory(replace(RunConfig(), max_memory="900MB"), PLUGINS, LARGE)


def test_a_run_says_and_writes_what_it_shrank(
    tiny_capture: Path, quick: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A capture of 64×64 pixels fits into anything: decoded pixels are counted as a thousand times as many bytes."""
    monkeypatch.setattr("hir_core.memory.DECODED", 17_000)
    monkeypatch.setattr("hir_core.memory.LEAST_CACHE", 1000)
    kept: list[int] = []
    plain = PixelCache.__init__
    monkeypatch.setattr(PixelCache, "__init__", lambda self, most: (kept.append(most), plain(self, most))[1])
    said: list[str] = []
    run = quick(tiny_capture, tmp_path / "run", until="initializer", max_memory="1.7GB", on_message=said.append)
    memory = run.directory.read_run()["memory"]
    assert memory["limit_bytes"] == int(1.7 * (1 << 30)) and set(memory["estimated_bytes"]) >= {"geometry", "export"}
    assert kept and kept[0] < 1 << 30 and any("cache of decoded photographs" in change for change in memory["changes"])
    assert any("to stay within 1.7 GB" in sentence for sentence in said)
    assert any("initializer: about" in sentence and "expected" in sentence for sentence in said)


def test_a_cache_that_is_full_still_reads(tmp_path: Path) -> None:
    from hir_core.testing.captures import tiny_capture

    capture = tiny_capture(tmp_path, views=4, size=32).capture
    cache = PixelCache(32 * 32 * 17 * 2)
    wrapped = cache.wrap(capture)
    for _ in range(2):
        for view, plain in zip(wrapped.views, capture.views, strict=True):
            assert (view.pixels().color_linear == plain.pixels().color_linear).all()
    assert 0 < cache.bytes <= 32 * 32 * 17 * 2
